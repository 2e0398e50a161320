"""Settings of the process that pay on small machines. Call before torch is imported."""

from __future__ import annotations

import ctypes
import os
import sys
import time

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
BEGAN = time.perf_counter()
"""About when the process was started, where this is imported before everything else: commands do."""

KEEP_BUFFER, KEEP_TOTAL = 1 << 25, 1 << 30
"""Freed buffers up to this size stay with the process, up to this much in all, bytes; glibc refuses a larger first."""


def tune() -> None:
    """Keeps freed memory and lets idle threads sleep.

    glibc returns every large buffer to the system, and a step of training makes dozens: mapping them again took half
    the time of a step.  OpenMP's threads spin while they wait for work, which takes a core from numba's threads: the
    two take turns many times a step.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if sys.platform == "linux":
        libc = ctypes.CDLL(None)
        if hasattr(libc, "mallopt"):  # musl has none
            libc.mallopt(M_MMAP_THRESHOLD, KEEP_BUFFER)
            libc.mallopt(M_TRIM_THRESHOLD, KEEP_TOTAL)

"""Settings of the process that pay on small machines. Call before torch is imported."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
BEGAN = time.perf_counter()
"""About when the process was started, where this is imported before everything else: commands do."""

KEEP_BUFFER, KEEP_TOTAL = 1 << 25, 1 << 30
"""Freed buffers up to this size stay with the process, up to this much in all, bytes; glibc refuses a larger first."""


GRACE_SECONDS = 3.0
"""For the step that a job is in when its parent ends."""


def end_with_parent(request: Callable[[], None]) -> None:
    """Ends this process soon after whoever holds the other end of its standard input has closed it, or has ended.

    Args:
        request: asks the job to end after its step.  What still runs after ``GRACE_SECONDS`` is killed, with all that
            it has started; files are whole or absent even then.
    """

    def watch() -> None:
        with contextlib.suppress(OSError):
            while os.read(0, 4096):  # not through sys.stdin, whose lock a thread must not hold at the end
                pass
        end_soon(request, GRACE_SECONDS)

    threading.Thread(target=watch, daemon=True).start()


def end_soon(request: Callable[[], None], seconds: float) -> None:
    """Asks the job to end after its step, and kills this process with all that it has started ``seconds`` later."""
    request()
    if sys.platform != "win32":  # the system's own alarm rings also where no thread gets its turn any more
        signal.setitimer(signal.ITIMER_REAL, seconds + 0.5)
    time.sleep(seconds)
    if sys.platform == "win32":
        os._exit(1)
    os.killpg(0, signal.SIGKILL) if os.getpgrp() == os.getpid() else os.kill(os.getpid(), signal.SIGKILL)


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

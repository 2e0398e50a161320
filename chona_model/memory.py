"""Memory of this process: what it has, what it had at most, and how to tell that there was not enough."""

from __future__ import annotations

import errno
from pathlib import Path

GIGABYTE = 2**30
_STATUS = Path("/proc/self/status")
_SIGNS = (
    "can't allocate memory",  # torch, on the processor
    "out of memory",  # torch, on the card
    "Cannot allocate memory",  # the system
    "failed to map segment",  # a library that is loaded
    "can't start new thread",
)


def resident() -> int | None:
    """Bytes that the process has now; None where the system does not say it."""
    return _of_status("VmRSS:")


def highest() -> int | None:
    """Bytes that it had at most; None where the system does not say it."""
    return _of_status("VmHWM:")


def _of_status(name: str) -> int | None:
    try:
        lines = _STATUS.read_text("utf-8", errors="replace").splitlines()
    except OSError:
        return None
    found = next((line for line in lines if line.startswith(name)), None)
    return None if found is None else int(found.split()[1]) * 1024


def was_short_of_memory(error: BaseException) -> bool:
    """Whether an exception means that memory was used up: libraries say so in many ways."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    return isinstance(error, RuntimeError | ImportError | OSError) and any(sign in str(error) for sign in _SIGNS)

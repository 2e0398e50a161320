"""Which process on which machine: told apart from another that has its number by now.

A process number alone says little: numbers are given again, a container counts by itself, and in a shared folder it
may be another machine's.  With the time of the process's start and a key of the machine (its name, its boot and what
counts processes there) it is said exactly.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path


@dataclass(frozen=True)
class Owner:
    """A process.

    Attributes:
        host: the machine's name, for people; machine: its key.
        pid: the process's number there; started: when it began, in the system's own words, empty where unknown.
    """

    host: str
    machine: str
    pid: int
    started: str

    @property
    def is_here(self) -> bool:
        """Whether it is, or was, a process that this one could see."""
        return self.machine == machine_key()

    def is_alive(self) -> bool:
        """Whether the process runs; False where its number belongs to another one by now.  Of this machine alone."""
        return self.is_here and process_start(self.pid) == self.started


def this_process() -> Owner:
    """The process that asks."""
    started = process_start(os.getpid())
    assert started is not None
    return Owner(platform.node(), machine_key(), os.getpid(), started)


@cache
def machine_key() -> str:
    """Eight digits that differ between machines, between boots of one machine, and between containers."""
    facts = [platform.node()]
    with contextlib.suppress(OSError):  # Linux has both
        facts.append(Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip())
        facts.append(str(Path("/proc/self/ns/pid").readlink()))
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:8]


def process_start(pid: int) -> str | None:
    """When a process began, in the system's own words; None where there is no such process.

    Empty on systems that do not say it.
    """
    if sys.platform == "win32":
        return _start_on_windows(pid)
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return None
    except OSError:  # another user's
        pass
    if sys.platform == "linux":
        try:
            text = Path(f"/proc/{pid}/stat").read_text("utf-8", errors="replace")
        except OSError:
            return None
        # The name in parentheses may hold anything, parentheses too.
        state, *fields = text.rpartition(")")[2].split()
        return None if state in "ZX" else fields[18]  # it has ended, and its parent has not looked yet
    listed = subprocess.run(["ps", "-o", "lstart=", "-p", str(pid)], capture_output=True, text=True, check=False)  # noqa: S607
    return listed.stdout.strip().replace(" ", "-") or None


def _start_on_windows(pid: int) -> str | None:
    if sys.platform != "win32":
        raise NotImplementedError
    import ctypes

    query, still_active = 0x1000, 259
    kernel = ctypes.windll.kernel32
    handle = kernel.OpenProcess(query, False, pid)
    if not handle:
        return None
    try:
        code = ctypes.c_ulong()
        times = [ctypes.c_ulonglong() for _ in range(4)]
        kernel.GetExitCodeProcess(handle, ctypes.byref(code))
        kernel.GetProcessTimes(handle, *(ctypes.byref(time) for time in times))
        return str(times[0].value) if code.value == still_active else None
    finally:
        kernel.CloseHandle(handle)

"""What a job that goes on without Blender leaves in its folder: how far it is, how it ended, whether it runs.

The worker replaces ``.chona-….json`` as a whole and keeps ``.chona-….log`` locked while it runs; a file
``.chona-….stop`` asks it to end (docs/file-formats.md).  No process is looked for by its number, and none is sent a
signal.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .events import understood

VERSION = 1
LARGEST_RECORD, KEPT_LOG = 1 << 20, 1 << 14
"""Bytes that are read of the file, and of the end of the log."""
LOCKED_BYTE = 1 << 30


def bake_record(folder: Path, name: str) -> Path:
    """The file of a bake of this name into a folder."""
    return folder / f".chona-bake-{name}.json"


def train_record(folder: Path) -> Path:
    """The file of a training into a folder."""
    return folder / ".chona-train.json"


@dataclass(frozen=True)
class JobRecord:
    """What a job has said.

    Attributes:
        host: the computer it runs on; pid: its number there; since, written: when it began, and said this, for people.
        start, progress, end: the last event of each kind, of docs/file-formats.md; None before there is one.
    """

    host: str
    pid: int
    since: str
    written: str
    start: dict[str, Any] | None
    progress: dict[str, Any] | None
    end: dict[str, Any] | None

    @property
    def is_here(self) -> bool:
        """Whether it is of this computer: of another's nothing can be said for sure."""
        return self.host == platform.node()

    @property
    def events(self) -> list[dict[str, Any]]:
        """All that there are, in their order."""
        return [event for event in (self.start, self.progress, self.end) if event is not None]


def read_record(path: Path) -> JobRecord | None:
    """The record in a file; None where there is none, or something that no job of this version writes."""
    try:
        with path.open("rb") as file:
            content = json.loads(file.read(LARGEST_RECORD))
        if content["version"] != VERSION:
            return None
        owner = content["owner"]
        return JobRecord(
            str(owner["host"]), int(owner["pid"]), str(content["since"]), str(content["written"]),
            *(_event(content[name]) for name in ("start", "progress", "end")),
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _event(content: object) -> dict[str, Any] | None:
    """An event, checked.

    Raises:
        ValueError: it is none.
    """
    if content is None:
        return None
    event = understood(content)
    if event is None:
        raise ValueError("no event")
    return event


def is_running(path: Path) -> bool | None:
    """Whether the job of a record runs; None where files cannot be locked, and so nobody knows."""
    try:
        handle = os.open(path.with_suffix(".log"), os.O_RDWR)
    except OSError:
        return False
    try:
        return _is_locked(handle)
    finally:
        os.close(handle)


def _is_locked(handle: int) -> bool | None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return True
        os.lseek(handle, LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_UNLCK, 1)
        return False
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)  # two that look do not stand in each other's way
    except BlockingIOError:
        return True
    except OSError:
        return None
    return False


def last_lines(path: Path) -> list[str]:
    """What the job of a record has printed last, besides its events."""
    try:
        with path.with_suffix(".log").open("rb") as file:
            file.seek(max(os.fstat(file.fileno()).st_size - KEPT_LOG, 0))
            text = file.read().decode("utf-8", "replace")
    except OSError:
        return []
    return [line for line in text.splitlines() if line.strip()]


def killed_words(record: JobRecord | None, lines: Sequence[str]) -> str:
    """Of a job that has ended and could not say how: when, and the last that it said.

    Args:
        lines: what it has printed.
    """
    words = "the worker was killed, or the computer went down"
    if record is not None:
        words += f", after {record.written}"
    said = next((line for line in reversed(lines) if not line.startswith("{")), "")
    return f"{words}; it said last: {said}" if said else words


def left_words(record: JobRecord) -> str:
    """What such a job has left, and how to go on."""
    told = record.progress or record.start
    if told is None:
        return "it had not begun: start it again"
    if told.get("job") != "bake":
        return "with Resume it goes on from its last checkpoint"
    share = f"{told.get('done') or 0:g} of {told.get('total') or 0:g}"
    return f"{share} frames were done: press Bake to go on with the rest"


def ask_to_end(path: Path) -> None:
    """Have the job of a record end after its step, and be ended ten seconds later if it has not."""
    with contextlib.suppress(OSError):
        path.with_suffix(".stop").touch()


def clear(path: Path) -> None:
    """Remove what a job that has ended has left, once it was told."""
    for ending in (".json", ".log", ".stop"):
        with contextlib.suppress(OSError):
            path.with_suffix(ending).unlink(missing_ok=True)

"""A job that nobody listens to says in a file how far it is and how it ended, and is asked through another to end.

``.chona-bake-NAME.json`` or ``.chona-train.json`` in the output folder is replaced as a whole, so a reader never meets
half of it and it does not grow.  Beside it lies ``.log``, what the job prints otherwise, which the job keeps locked by
the system for as long as it runs: a file whose ``.log`` somebody else can lock belongs to a job that has ended, however
it ended.  A file ``.stop`` asks it to end.  Nobody has to know a process by its number, so none is ever mistaken.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec

from chona_model import process
from chona_model.formats.atomic import WriteError, write_bytes
from chona_model.formats.folder_lock import FolderBusyError, try_lock
from chona_model.owner import Owner, this_process

VERSION = 1
LOOK_SECONDS, BEAT_SECONDS = 0.5, 5.0
"""The file is written as often where there is news, and touched as often where there is none."""
LOCK_SECONDS = 5.0
"""Longest time that readers, who try the lock for a moment, may stand in its way."""
STOP_SECONDS = 10.0
"""For the step that a job is in when it is asked to end."""
MOST_LOG = 1 << 17
"""Bytes of ``.log``; when it is full it begins anew."""
LARGEST = 1 << 20
"""Bytes of a file that are read."""
END_EVENTS = ("result", "cancelled", "error")


def bake_file(out: Path, shot: str) -> Path:
    """The file of a bake of the shot with this name into ``out``."""
    return out / f".chona-bake-{shot}.json"


def train_file(out: Path) -> Path:
    """The file of a training into ``out``."""
    return out / ".chona-train.json"


def job_files(out: Path) -> list[Path]:
    """The files of all jobs that have been left in a folder."""
    found = sorted(out.glob(".chona-bake-*.json"))
    return [*found, *(path for path in [train_file(out)] if path.is_file())]


def read_job(path: Path) -> dict[str, Any] | None:
    """What a job has said in its file; None where there is none, or something else."""
    try:
        with path.open("rb") as file:
            content = msgspec.json.decode(file.read(LARGEST), type=_Said)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return None
    return msgspec.to_builtins(content) if content.version == VERSION else None


class _Event(msgspec.Struct):
    event: str
    done: float | None = None
    total: float | None = None
    eta: float | None = None
    message: str | None = None


class _Said(msgspec.Struct):
    version: int
    owner: Owner
    since: str
    written: str
    start: _Event | None
    progress: _Event | None
    end: _Event | None


def is_running(path: Path) -> bool:
    """Whether the job of a file runs; False also where the system cannot lock files."""
    try:
        handle = os.open(path.with_suffix(".log"), os.O_RDWR)
    except OSError:
        return False
    try:
        return try_lock(handle) is False
    finally:
        os.close(handle)


class JobFile:
    """The file of this process's job.

    Args:
        path: ends in ``.json``; words: the command.
        request: asks the job to end after its step; what still runs ``STOP_SECONDS`` later is killed.

    Raises:
        FolderBusyError: another job has this file.  WriteError: it cannot be written.
    """

    def __init__(self, path: Path, words: Sequence[str], request: Callable[[], None]) -> None:
        self.path, self.log, self.stop = path, path.with_suffix(".log"), path.with_suffix(".stop")
        self._request, self._guard, self._closed = request, threading.Lock(), threading.Event()
        self._content: dict[str, Any] = {
            "version": VERSION, "owner": asdict(this_process()), "since": _now(), "command": list(words),
            "start": None, "progress": None, "end": None,
        }  # fmt: skip
        self._changed, self._written = False, 0.0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._handle = os.open(self.log, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        except OSError as error:
            raise WriteError(path, error) from error
        try:
            self._lock()
            self.stop.unlink(missing_ok=True)
            self._write()
        except BaseException:
            os.close(self._handle)
            raise
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def take(self, event: Mapping[str, Any]) -> None:
        """Keeps an event for those who look; the last of a job is written at once."""
        with self._guard:
            kind = event["event"]
            if kind == "start":
                self._content |= {"start": event, "progress": None, "end": None}
            else:
                self._content["end" if kind in END_EVENTS else "progress"] = event
            self._changed = True
        if kind in END_EVENTS:
            self._tell()

    def close(self) -> None:
        """The job has ended: what it has said stays."""
        self._closed.set()
        self._thread.join()
        self._tell()
        with contextlib.suppress(OSError):
            self.stop.unlink(missing_ok=True)
        os.close(self._handle)

    def _lock(self) -> None:
        until = time.monotonic() + LOCK_SECONDS
        while try_lock(self._handle) is False:
            if time.monotonic() > until:
                raise FolderBusyError(
                    f"{self.path} belongs to another job that runs already; wait until it has ended, or create "
                    f"{self.stop.name} there to end it"
                )
            time.sleep(0.05)

    def _run(self) -> None:
        asked = False
        while not self._closed.wait(LOOK_SECONDS):
            self._tell()
            with contextlib.suppress(OSError):
                if os.fstat(self._handle).st_size > MOST_LOG:
                    os.ftruncate(self._handle, 0)
                if not asked and self.stop.exists():
                    asked = True
                    threading.Thread(target=process.end_soon, args=(self._request, STOP_SECONDS), daemon=True).start()

    def _tell(self) -> None:
        """Writes what is new.  A disk that is full, or a folder that is gone, is told of by the job itself."""
        with contextlib.suppress(OSError), self._guard:
            if not self.path.parent.is_dir():
                return
            if self._changed:
                self._write()
                self._changed = False
            elif time.monotonic() - self._written > BEAT_SECONDS:
                os.utime(self.path)
                self._written = time.monotonic()

    def _write(self) -> None:
        self._written = time.monotonic()
        write_bytes(self.path, json.dumps({**self._content, "written": _now()}, ensure_ascii=False).encode())


def _now() -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S")

"""A worker that does not end with Blender: it is followed through a file, by the Blender that started it or another.

A thread looks at the file, which may lie on a slow drive; what it finds is taken in Blender's main thread.
"""

from __future__ import annotations

import contextlib
import subprocess
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import job_record
from .errors import ChonaError
from .job_record import JobRecord
from .worker import KEPT_LINES, last_words, running, start_process

LOOK_SECONDS = 0.2
SILENT_SECONDS = 30.0
"""Where files cannot be locked, a job whose file was not touched for so long has ended: it does so every five."""
KILLED = -9
"""Stands for the exit code of a process that nobody here has started and that has not said how it ended."""


class DetachedWorker:
    """A process that goes on when this is closed.  Like `worker.Worker`, but for that."""

    goes_on = True

    def __init__(self, record: Path, command: Sequence[str] = (), process: subprocess.Popen[Any] | None = None) -> None:
        self.record_path, self.command = record, [str(part) for part in command]
        self.lines: deque[str] = deque(maxlen=KEPT_LINES)
        self.cancelled_at: float | None = None
        self._process = process
        self._record: JobRecord | None = None
        self._told: list[dict[str, Any]] = []
        self._stamp, self._changed_at = -1, time.monotonic()
        self._code: int | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()
        running.add(self)

    @classmethod
    def start(cls, command: Sequence[str], record: Path) -> DetachedWorker:
        """Start a process that tells in the file `record` how far it is.

        Raises:
            ChonaError: the program does not start, the folder cannot be written, or the same runs already.
        """
        if job_record.is_running(record):
            raise ChonaError(f"the job of {record} runs already; wait until it has ended, or cancel it")
        job_record.clear(record)
        try:
            with record.with_suffix(".log").open("ab") as log:
                started = start_process(command, None, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        except OSError as error:
            raise ChonaError(f"cannot write {record}: {error.strerror or error}; choose another folder") from error
        return cls(record, command, started)

    def _follow(self) -> None:
        while self._code is None and not self._closed.wait(LOOK_SECONDS):
            self._look()

    def _look(self) -> None:
        if self.cancelled_at is not None:
            job_record.ask_to_end(self.record_path)  # the worker takes away what it finds when it begins
        alive = self._is_alive()  # before the file is read: what it says last is not missed
        record = job_record.read_record(self.record_path)
        if record is not None:
            self._record = record
        if not alive:
            self.lines.extend(job_record.last_lines(self.record_path))
            self._code = self._code_of(self._record)

    def _is_alive(self) -> bool:
        if self._process is not None:
            return self._process.poll() is None
        runs = job_record.is_running(self.record_path)
        if runs is not None:
            return runs
        with contextlib.suppress(OSError):
            stamp = self.record_path.stat().st_mtime_ns
            if stamp != self._stamp:
                self._stamp, self._changed_at = stamp, time.monotonic()
        return time.monotonic() - self._changed_at < SILENT_SECONDS

    def _code_of(self, record: JobRecord | None) -> int:
        end = record.end if record is not None else None
        if end is not None and end["event"] == "cancelled" and self.cancelled_at is None:
            self.cancelled_at = time.monotonic()  # by somebody else
        if self._process is not None and self._process.returncode is not None:
            return int(self._process.returncode)
        if end is None:
            return KILLED
        return 0 if end["event"] == "result" else int(end.get("code") or 1)

    def events(self) -> list[dict[str, Any]]:
        """What is new in the file since the last call."""
        before, self._told = self._told, self._record.events if self._record is not None else []
        return [event for event in self._told if event not in before]

    def code(self) -> int | None:
        """The exit code once the process has ended, else None; what it has left in the folder is removed then."""
        if self._code is not None and not self._closed.is_set():
            self.close()
            job_record.clear(self.record_path)
        return self._code

    def last_words(self, code: int) -> str:
        """How the process ended, and the last that it said."""
        if code == KILLED:
            return job_record.killed_words(self._record, list(self.lines))
        return last_words(code, self.lines)

    def cancel(self) -> None:
        """Ask the worker to stop after its current step; it ends itself when that takes longer than ten seconds."""
        if self.cancelled_at is None:
            self.cancelled_at = time.monotonic()
            job_record.ask_to_end(self.record_path)

    def press(self) -> None:
        """Nothing: the worker counts its grace time itself."""

    def close(self) -> None:
        """Look no longer; the process goes on."""
        self._closed.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=2.0)
        running.discard(self)

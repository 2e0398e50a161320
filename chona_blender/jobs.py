"""A worker with what it has said so far, and the one that runs at present.

A `Job` is what panels draw: title, share done, time left, last words. It never touches Blender's data, so it can be
polled anywhere. Operators over one: `job_operator`.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import bpy

from . import messages
from .detached_worker import DetachedWorker
from .worker import Worker

POLL_SECONDS = 0.1
RUNNING, DONE, FAILED, CANCELLED = "RUNNING", "DONE", "FAILED", "CANCELLED"


class Job:
    """A worker with what it has reported so far.

    Args:
        command: of the worker, or one that is there already and goes on without Blender.
    """

    remedy = "cancel it"

    def __init__(
        self, title: str, command: Sequence[str] | DetachedWorker, environment: dict[str, str] | None = None
    ) -> None:
        self.title = title
        self.status = RUNNING
        self.done = 0.0
        self.total = 0.0
        self.eta: float | None = None
        self.words = "starting the worker"
        self.measures: dict[str, float] = {}
        self.result: dict[str, Any] = {}
        self.error = ""
        self.code: int | None = None
        self.started = time.monotonic()
        self.worker = command if isinstance(command, DetachedWorker) else Worker(command, environment)

    @property
    def share(self) -> float:
        """Part done, 0 to 1."""
        return min(max(self.done / self.total, 0.0), 1.0) if self.total > 0 else 0.0

    @property
    def text(self) -> str:
        """One line: what is done, of what, and for how long still."""
        if self.status == RUNNING and self.worker.cancelled_at is not None:
            return "stopping after the current step"
        if self.total <= 0:
            return self.words
        parts = [f"{self.done:g} of {self.total:g}"]
        if self.eta is not None and self.status == RUNNING:
            parts.append(f"{duration(self.eta)} left")
        parts += [f"{name} {value:.4g}" for name, value in self.measures.items()]
        return ", ".join(parts)

    @property
    def report(self) -> str:
        """Everything known about the job, to be copied."""
        lines = [f"job: {self.title}", f"status: {self.status}", f"exit code: {self.code}", f"error: {self.error}"]
        return "\n".join([*lines, f"command: {' '.join(self.worker.command)}", "output:", *self.worker.lines])

    def poll(self) -> bool:
        """Take in what the worker has said; True once it has ended."""
        if self.status != RUNNING:
            return True
        self.worker.press()
        code = self.worker.code()
        for event in self.worker.events():
            self._take(event)
        if code is None:
            return False
        self.code = code
        if code == 0 and self.result:
            self.status, self.done = DONE, self.total
        elif self.worker.cancelled_at is not None:
            self.status, self.error = CANCELLED, self._and_left(f"{self.title} was cancelled")
        else:
            self.status, self.error = FAILED, self.error or self._and_left(self.worker.last_words(code))
            if code == 0:
                self.error += "; expected a result"
        return True

    def what_is_left(self) -> str:
        """What a job leaves that ended before its time, and how to go on; nothing where there is nothing to say."""
        return ""

    def _and_left(self, words: str) -> str:
        left = self.what_is_left()
        return f"{words}; {left}" if left else words

    def _take(self, event: dict[str, Any]) -> None:
        kind = event["event"]
        if kind in {"start", "progress"}:
            self.done, self.eta = event.get("done", 0.0), event.get("eta")
            self.total = event.get("total") or self.total
            self.words = event.get("message") or self.words
            self.measures = {name: event[name] for name in ("loss", "psnr") if event.get(name) is not None}
        elif kind == "result":
            self.result = event
        elif kind == "error":
            self.error = event.get("message", "")

    def cancel(self) -> None:
        """Ask the worker to stop; `poll` tells when it has."""
        self.worker.cancel()

    def close(self) -> None:
        """End the worker now, whatever it does; one that goes on without Blender is left to itself."""
        self.worker.close()
        self.poll()


@dataclass
class _Board:
    """The job that runs and the last one that ended: what the panels show; and what the running one has of Blender.

    Attributes:
        timer: wakes the running job's operator; told: workspaces whose status bars its words are in, by number.
    """

    current: Job | None = None
    last: Job | None = None
    timer: bpy.types.Timer | None = None
    told: set[int] = field(default_factory=set)


board = _Board()


def let_go() -> None:
    """No job runs any more: its timer goes, and its words in the status bars."""
    if board.timer is not None:
        bpy.context.window_manager.event_timer_remove(board.timer)
    board.current = board.timer = None
    if board.told:
        for workspace in bpy.data.workspaces:
            if workspace.session_uid in board.told:
                workspace.status_text_set(None)
        board.told.clear()


def end() -> None:
    """End the running job and forget all: the add-on is switched off, and Blender drops the operator without a word."""
    if board.current is not None:
        board.current.close()
    let_go()
    board.last = None
    messages.forget()


def running() -> Job | None:
    """The job that a modal operator runs at present."""
    return board.current


def busy() -> str:
    """Why nothing else can start at present, as a button's tooltip says it; nothing when nothing runs."""
    if board.current is None:
        return ""
    return f"Wait until the running job has ended, or {board.current.remedy}: {board.current.title}"


def duration(seconds: float) -> str:
    """`75` -> `1 min 15 s`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def run_blocking(job: Job, progress: Callable[[Job], None] | None = None) -> Job:
    """Wait for the job. SIGINT and SIGTERM to Blender, as a render farm sends them, stop the worker first."""
    board.last = job
    with _signals_cancel(job):
        try:
            while not job.poll():
                if progress is not None:
                    progress(job)
                time.sleep(POLL_SECONDS / 2)
        finally:
            job.close()
    return job


@contextmanager
def _signals_cancel(job: Job) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(name, lambda *_: job.cancel()) for name in names]
    try:
        yield
    finally:
        for name, handler in zip(names, before, strict=True):
            signal.signal(name, handler if handler is not None else signal.SIG_DFL)

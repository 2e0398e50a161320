"""How long jobs report: a bar on a terminal, or JSON lines on stdout for a program that watches.

A job calls ``start``, then ``update`` after every step, looks at ``cancelled_by_user`` between steps, and ends with
``result`` or ``cancelled``.  Whoever started the job reports an ``error``.  ``Cancel`` turns SIGINT and SIGTERM into a
flag, so that a job ends after the step it is in, with its files whole.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from types import FrameType, TracebackType
from typing import Any, Protocol, Self, TextIO

MODES = ("terminal", "json")
UPDATE_SECONDS = 0.2
"""Shortest time between two updates; the last one before the end is always written to JSON."""


class Cancelled(Exception):
    """The job ended on request before it was done; what it had finished is on the disk."""


class Cancel:
    """A flag that SIGINT and SIGTERM set while the block runs; the handlers from before are put back after it.

    A second SIGINT raises KeyboardInterrupt: the user does not want to wait for the step to end.  Outside the main
    thread no handler can be installed; there the flag is set by ``request`` alone.

    Attributes:
        requested: the flag; continued: how often the process was stopped (SIGSTOP, Ctrl-Z) and goes on.
    """

    def __init__(self) -> None:
        self.requested = False
        self.continued = 0
        self._interrupted = False
        self._before: dict[int, Any] = {}

    def request(self) -> None:
        """Asks the job to end after the current step."""
        self.requested = True

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._handle)
            if sys.platform != "win32":
                self._before[signal.SIGCONT] = signal.signal(signal.SIGCONT, self._go_on)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            # None stands for a handler that was not installed from Python and cannot be put back by it.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before.clear()

    def _go_on(self, _number: int, _frame: FrameType | None) -> None:
        self.continued += 1

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        self.requested = True
        if number == signal.SIGINT:
            if self._interrupted:
                raise KeyboardInterrupt
            self._interrupted = True


class Record(Protocol):
    """Takes events in the place of stdout."""

    def take(self, event: Mapping[str, Any]) -> None:
        """Keeps an event."""

    def close(self) -> None:
        """Keeps what has not been kept yet."""


class Progress:
    """Reports one job.

    Args:
        mode: ``terminal`` draws a bar on stderr where that is a terminal and is quiet elsewhere; ``json`` writes the
            events of ``docs/file-formats.md`` on stdout, one a line, each flushed.
        cancel: the flag that ``cancelled_by_user`` shows.
        output: where JSON lines go; stdout as it is now when None.
        errors: where bars and messages go; stderr when None.
        clock: seconds that only grow.

    Attributes:
        quiet: whether nothing is written: of several processes of one job, one reports.
        record: takes JSON's events where nobody reads stdout.
        job: name given to ``start``.
        ended: ``result``, ``cancelled`` or ``error`` once the job has ended, else None.
    """

    def __init__(
        self,
        mode: str = "terminal",
        cancel: Cancel | None = None,
        *,
        output: TextIO | None = None,
        errors: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if mode not in MODES:
            raise ValueError(f"the progress mode is '{mode}', expected {' or '.join(MODES)}")
        self.mode = mode
        self.cancel = Cancel() if cancel is None else cancel
        self.quiet = False
        self.record: Record | None = None
        self.job = ""
        self.ended: str | None = None
        self._output = sys.stdout if output is None else output
        self._errors = sys.stderr if errors is None else errors
        self._clock = clock
        self._total: float | None = 0.0
        self._first = 0.0
        self._started = clock()
        self._written = -math.inf
        self._held: dict[str, Any] | None = None
        self._bar: Any = None

    @property
    def cancelled_by_user(self) -> bool:
        """Whether the job was asked to end; look at it after every step and frame."""
        return self.cancel.requested

    def check(self) -> None:
        """Raises ``Cancelled`` when the job was asked to end: for places with nothing to put away."""
        if self.cancelled_by_user:
            raise Cancelled

    def start(self, job: str, total: float | None, done: float = 0.0, unit: str = "") -> None:
        """Begins the job; ``total`` in the unit of ``update``'s ``done``, which starts at ``done`` when resumed.

        A ``total`` of None stands for a job whose length is not known; it has no ``eta``.
        """
        self.job, self.ended, self._held = job, None, None
        self._total, self._first = total, done
        self._started, self._written = self._clock(), -math.inf
        if self.mode == "json":
            self._write({"event": "start", "job": job, "total": total} | ({"done": done} if done else {}))
        elif self._errors.isatty() and not self.quiet:
            from tqdm import tqdm

            self._close_bar()
            self._bar = tqdm(total=total, initial=done, desc=job, unit=unit or "it", file=self._errors, leave=False,
                             dynamic_ncols=True, bar_format="{desc} {percentage:3.0f}%|{bar}| {n:.5g}/{total:.5g} "
                             "{elapsed}<{remaining}{postfix}")  # fmt: skip

    def update(self, done: float, message: str = "", *, at_once: bool = False, **fields: Any) -> None:
        """Says how far the job is, with numbers such as ``loss`` and ``psnr``.  Cheap: call it after every step.

        Args:
            at_once: write the event also where the last was written a moment ago: something is finished for good.
        """
        now = self._clock()
        left = None if self._total is None else max(self._total - done, 0.0)
        due = at_once or now - self._written >= UPDATE_SECONDS or left == 0
        if self.mode == "terminal":
            if self._bar is not None and due:
                words = [message] if message else []
                words += [f"{name} {value:.4g}" for name, value in fields.items() if isinstance(value, int | float)]
                self._bar.set_postfix_str(", ".join(words), refresh=False)
                self._bar.n, self._written = done, now
                self._bar.refresh()
            return
        seconds = now - self._started
        advanced = done - self._first
        eta = round(seconds / advanced * left, 1) if advanced > 0 and left is not None else None
        event = {"event": "progress", "job": self.job, "done": done, "total": self._total,
                 "seconds": round(seconds, 3), "eta": eta}  # fmt: skip
        self._held = event | ({"message": message} if message else {}) | fields
        if due:
            self._flush(now)

    def result(self, **fields: Any) -> None:
        """Ends a job that did what it should; ``fields`` say what it left."""
        self._end("result", fields)

    def cancelled(self, **fields: Any) -> None:
        """Ends a job that was asked to; ``fields`` say what it left."""
        self._end("cancelled", fields)
        if self.mode == "terminal":
            self._say(f"{self.job or 'the command'} was cancelled")

    def error(self, message: str, code: int) -> None:
        """Ends a job that failed: one line on stderr, and the event where events are written."""
        line = " ".join(message.split())
        self._end("error", {"code": code, "message": line})
        self._say(line)

    def _end(self, event: str, fields: Mapping[str, Any]) -> None:
        self.ended = event
        self._close_bar()
        if self.mode == "json":
            self._flush(self._clock())
            self._write({"event": event, "job": self.job, **fields})

    def _say(self, line: str) -> None:
        if not self.quiet:
            self._errors.write(f"chona: {line}\n")
            self._errors.flush()

    def _flush(self, now: float) -> None:
        if self._held is not None:
            self._write(self._held)
            self._held, self._written = None, now

    def _write(self, event: Mapping[str, Any]) -> None:
        if self.quiet:
            return
        if self.record is not None:
            self.record.take(_plain(event))
            return
        try:
            self._output.write(json.dumps(_plain(event), allow_nan=False, ensure_ascii=False) + "\n")
            self._output.flush()
        except BrokenPipeError:  # whoever started the job has ended: the step is finished, and what it gave is kept
            self.cancel.request()
            with open(os.devnull, "wb") as nowhere:  # noqa: PTH123 - no path
                os.dup2(nowhere.fileno(), self._output.fileno())

    def _close_bar(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def _plain(value: Any) -> Any:
    """What JSON can hold: numbers of numpy and torch become Python's, paths and the like text, NaN and Inf null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    return _plain(value.item()) if hasattr(value, "item") else str(value)

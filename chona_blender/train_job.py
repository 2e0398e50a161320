"""A training that runs: a job that can be paused, and whose curves and pictures are shown while it goes on."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .detached_worker import DetachedWorker
from .jobs import CANCELLED, DONE, RUNNING, Job, duration
from .train_view import TrainView

PAUSED = "PAUSED"
CHECKPOINT = "checkpoint.safetensors"
STOP = "stop"
"""A file of this name in the result folder ends the training after its step (docs/capture-and-train.md): unlike a
signal, it is understood on every system, and nothing is lost however long the step takes."""
CLOSING_SECONDS = 8.0
"""How long Blender waits for a checkpoint when it quits or opens another file."""


class TrainJob(Job):
    """A running `chona train`.

    Attributes:
        key: of its row; run: its result folder; status: may be `PAUSED` as well.
        told: called with the job after every look at it.
    """

    remedy = "pause it under Train"

    def __init__(
        self, title: str, command: Sequence[str] | DetachedWorker, run: Path, key: str, told: Callable[[TrainJob], None]
    ) -> None:
        self.run, self.key, self.told = run, key, told
        self.view = TrainView(run)
        self._becomes = ""
        self._stopped = False
        _remove(run / STOP)
        super().__init__(title, command)

    @property
    def text(self) -> str:
        """One line: steps, time left and quality."""
        if self.status == RUNNING and self._becomes:
            return "finishing the step, then writing a checkpoint"
        if self.total <= 0:
            return self.words
        parts = [self.words]
        if self.eta is not None and self.status == RUNNING:
            parts.append(f"{duration(self.eta)} left")
        return ", ".join([*parts, *(f"{name.upper()} {self.measures[name]:.1f} dB" for name in ("psnr",)
                                    if name in self.measures)])  # fmt: skip

    @property
    def stopping(self) -> bool:
        """Whether it was asked to stop, and has not yet."""
        return self.status == RUNNING and bool(self._becomes)

    def pause(self) -> None:
        """Ask for a checkpoint and an end; `poll` tells when it is there."""
        self._ask(PAUSED)

    def cancel(self) -> None:
        """As `pause`, for good; asked a second time, the process is ended after a grace time."""
        if self._becomes == CANCELLED:
            super().cancel()
        self._ask(CANCELLED)

    def _ask(self, becomes: str) -> None:
        self._becomes = becomes
        with contextlib.suppress(OSError):
            (self.run / STOP).touch()

    def poll(self) -> bool:
        """Take in what the worker and its files say; True once it has ended."""
        if self.status != RUNNING:
            return True
        if self._becomes and not self._stopped:
            self._ask(self._becomes)  # the worker takes away what it finds before its first step
        ended = super().poll()
        if ended:
            _remove(self.run / STOP)
            if self.status != DONE and (self._stopped or self.worker.cancelled_at is not None):
                self.status = self._becomes or PAUSED  # its checkpoint is there, whoever ended it
                self.error = f"{self.title} was {self.status.lower()}"
        self.view.follow(force=ended)
        self.told(self)
        return ended

    def what_is_left(self) -> str:
        """Whether a checkpoint is there, and that Resume goes on."""
        if (self.run / CHECKPOINT).is_file():
            return "its last checkpoint is there: press Resume to go on from it"
        return "it has written no checkpoint yet: press Resume to begin again"

    def _take(self, event: dict[str, Any]) -> None:
        super()._take(event)
        self._stopped = self._stopped or event["event"] == "cancelled"

    def close(self) -> None:
        """End the worker now, with a checkpoint where that does not take long, unless it goes on without Blender."""
        if self.status == RUNNING and not self.worker.goes_on:
            self.pause()
            end = time.monotonic() + CLOSING_SECONDS
            while time.monotonic() < end and not self.poll():
                time.sleep(0.05)
        super().close()


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)

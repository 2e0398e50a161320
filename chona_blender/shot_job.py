"""A job on a shot that nobody needs afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from tempfile import TemporaryDirectory

from .detached_worker import DetachedWorker
from .jobs import Job


class ShotJob(Job):
    """A job whose shot stands in a folder that goes with its end; without one the shot stays."""

    def __init__(
        self, title: str, command: Sequence[str] | DetachedWorker, place: TemporaryDirectory[str] | None = None
    ) -> None:
        self._place = place
        super().__init__(title, command)

    def poll(self) -> bool:
        """As every job's; with its end the shot goes."""
        ended = super().poll()
        if ended and self._place is not None:
            self._place.cleanup()
        return ended

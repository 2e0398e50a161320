"""Jobs on a shot."""

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


class BakeJob(ShotJob):
    """A bake: its finished frames outlast it."""

    def what_is_left(self) -> str:
        """How many frames are there, and that the same bake goes on with the others."""
        if self.total <= 0:
            return "no frame was begun; bake again"
        there = f"{self.done:g} of {self.total:g} frames are there"
        overwrites = "; set Existing Frames to Update to keep them" if "--overwrite" in self.worker.command else ""
        return f"{there}{overwrites}; bake again to go on with the rest"


def replaced_words(result: dict[str, object]) -> str:
    """That the model's file is another one since a bake has read it, from the worker's result; or nothing."""
    if not result.get("model_replaced"):
        return ""
    return "The model file was replaced during the bake: all frames are of the model before; bake again for the new one"

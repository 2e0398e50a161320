"""A capture, a model and a shot small enough to be trained and baked many times over."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cli_files import write_capture, write_tiny_shot
from fault_nursery import Nursery
from fault_runs import bake_words, train_words

FRAMES, STEPS = 24, 40


@dataclass(frozen=True)
class Scene:
    """Files that tests only read.

    Attributes:
        nursery: makes processes that need not load anything.
        capture: its folder; run: of a training of ``STEPS`` steps, frames: of a bake, neither interrupted.
        shot: of ``FRAMES`` frames.
    """

    nursery: Nursery
    capture: Path
    run: Path
    shot: Path
    frames: Path

    @property
    def model(self) -> Path:
        """The model of that training."""
        return self.run / "model.safetensors"

    def train(self, out: Path, *more: str) -> list[str]:
        """A training that goes on where the last one ended, if there was one."""
        there = (out / "checkpoint.safetensors").exists()
        return train_words(self.capture, out, STEPS, *(["--resume"] if there else []), *more)[1:]

    def bake(self, out: Path, *more: str) -> list[str]:
        """A bake of the whole shot."""
        return bake_words(self.model, self.shot, out, *more)[2:]


def make_scene(folder: Path) -> Scene:
    """Makes everything; the nursery is to be closed."""
    nursery = Nursery(folder)
    capture = write_capture(folder / "capture")
    made = Scene(nursery, capture, folder / "run", folder / "walk.shot.npz", folder / "frames")
    write_tiny_shot(made.shot, made.capture, frames=FRAMES)
    nursery.warm(made.train(made.run), made.bake(made.frames))
    return made

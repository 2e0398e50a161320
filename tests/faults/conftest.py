"""A capture, a model and a shot small enough to be trained and baked many times over."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "model"))
sys.path.insert(0, str(Path(__file__).parents[1] / "model" / "train"))

from cli_files import write_capture, write_tiny_shot
from fault_runs import finish, train_words

FRAMES, STEPS = 6, 40


@dataclass(frozen=True)
class Scene:
    """Files that tests only read.

    Attributes:
        capture: its folder; run: of a training of ``STEPS`` steps that nothing interrupted; shot: of ``FRAMES`` frames.
    """

    capture: Path
    run: Path
    shot: Path

    @property
    def model(self) -> Path:
        """The model of that training."""
        return self.run / "model.safetensors"


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("scene")
    made = Scene(write_capture(folder / "capture"), folder / "run", folder / "walk.shot.npz")
    write_tiny_shot(made.shot, made.capture, frames=FRAMES)
    finish(train_words(made.capture, made.run, STEPS))
    return made

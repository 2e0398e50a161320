"""What counts as training: its time budget is of steps, not of compiling kernels, which every process does anew."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from tiny_capture import tiny_capture
from tiny_models import SETTINGS, SHAPE

from chona_model.progress import Progress
from chona_model.train.grid_trainer import GridTrainer
from chona_model.train.run import TrainRun, held_folder, run_trainer

COMPILING = 2.0
"""Seconds."""
ROUNDING = 0.01
"""Seconds, of what two runs say."""


class SlowToStart(GridTrainer):
    """The first step of a process takes as long as one that compiles.

    Attributes:
        stepped: seconds of all steps but that.
    """

    stepped: float | None = None

    def step(self, index: int, share: float) -> dict[str, float]:
        began = time.perf_counter()
        report = super().step(index, share)
        if self.stepped is None:
            time.sleep(COMPILING)
            self.stepped = 0.0
        else:
            self.stepped += time.perf_counter() - began
        return report


def test_compiling_is_not_counted_also_when_resumed(tmp_path: Path) -> None:
    dataset = tiny_capture(tmp_path / "capture", persons=1, objects=1, frames=2, cameras=2, size=(32, 24))
    out = tmp_path / "run"
    seconds, stepped = [0.0], 0.0
    for steps in (10, 20):
        trainer = SlowToStart(dataset, SETTINGS, 0, shape=SHAPE)
        run = TrainRun(steps=steps, resume=steps > 10)
        with held_folder(out) as held:
            _, training = run_trainer(trainer, dataset, out, held, run, {}, Progress())
        assert training["steps"] == steps
        seconds.append(training["seconds"])
        stepped += trainer.stepped
    assert (np.diff(seconds) > 0.0).all()
    assert stepped - ROUNDING < seconds[-1] < stepped + COMPILING / 2

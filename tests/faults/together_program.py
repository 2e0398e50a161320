"""``chona`` with small trainers, of which process 1 fails in a step: ``together_program.py train --data …``.

The environment says in which: ``CHONA_TEST_FAIL_AT``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "model" / "train"))

import tiny_runs

import chona_model.train.run as loop
from chona_model.cli import main
from chona_model.data.dataset import Dataset
from chona_model.launch import read_launch


def make_failing(dataset: Dataset, run: loop.TrainRun) -> tuple[loop.Trainer, dict]:
    """In place of ``run.make_trainer``."""
    trainer, settings = tiny_runs.make_small(dataset, run)
    whole_step = trainer.step

    def step(index: int, share: float) -> dict[str, float]:
        if index == int(os.environ["CHONA_TEST_FAIL_AT"]) and read_launch().rank == 1:
            raise OSError("the card has fallen out")
        return whole_step(index, share)

    trainer.step = step  # type: ignore[method-assign]
    return trainer, settings


if __name__ == "__main__":
    loop.make_trainer, loop.LOG_EVERY, loop.CHECKPOINT_SECONDS = make_failing, 1, 0.1  # type: ignore[assignment]
    sys.exit(main(sys.argv[1:]))

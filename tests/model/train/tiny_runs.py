"""Trainings small enough to be run through the real loop many times: both presets, and the command line around them.

Run as a program it is ``chona`` with small trainers: ``python tiny_runs.py train --data …``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import pytest
import torch
from tiny_models import SETTINGS, SHAPE

import chona_model.train.run as loop
from chona_model.data.dataset import Dataset
from chona_model.deform.skinning import DeformShape
from chona_model.field.radiance import FieldShape
from chona_model.methods import METHODS
from chona_model.progress import Progress
from chona_model.settings import ExactSettings, InverseSettings
from chona_model.train.exact_trainer import ExactTrainer, PaperSettings, make_shape
from chona_model.train.grid_trainer import GridTrainer
from chona_model.train.objects import object_distance

RATES = ("grid_rate", "mlp_rate", "light_rate", "skin_rate", "offset_rate")
FAST = replace(SETTINGS, rays=128, skin_every=2)
PAPER = PaperSettings(
    rays=32, chunk=32, initial_steps=20,
    exact=ExactSettings(samples=8, bounded=True, inverse=InverseSettings(starts=2, steps=4, tolerance=1e-4)),
)  # fmt: skip


def fast_trainer(
    dataset: Dataset, run: loop.TrainRun, dtype: torch.dtype = torch.float32, **rates: float
) -> GridTrainer:
    """A small grid trainer; ``rates`` are factors on the settings' numbers."""
    settings = replace(
        FAST, **{name: type(getattr(FAST, name))(getattr(FAST, name) * factor) for name, factor in rates.items()}
    )
    return GridTrainer(dataset, settings, run.seed, run.image_scale, METHODS[run.method], shape=SHAPE, dtype=dtype)


def paper_trainer(dataset: Dataset, run: loop.TrainRun, factor: float = 1.0) -> ExactTrainer:
    """A small exact trainer with ``factor`` on both rates."""
    shape = replace(
        make_shape(dataset, object_distance(dataset)), code_size=4, deform=replace(DeformShape(), width=24, depth=2),
        radiance=replace(FieldShape(), width=32, depth=3),
    )  # fmt: skip
    settings = replace(PAPER, first_rate=PAPER.first_rate * factor, last_rate=PAPER.last_rate * factor)
    return ExactTrainer(dataset, settings, run.seed, run.device, run.image_scale, METHODS[run.method], shape=shape)


def make_small(dataset: Dataset, run: loop.TrainRun) -> tuple[loop.Trainer, dict]:
    """In place of ``run.make_trainer``."""
    return {"fast": fast_trainer, "paper": paper_trainer}[run.preset](dataset, run), {}


def train(
    patch: pytest.MonkeyPatch,
    dataset: Dataset,
    out: Path,
    make: Callable[..., loop.Trainer] | None = None,
    **run: object,
) -> Path:
    """The real loop around small trainers, or the one that ``make`` gives."""
    patch.setattr(loop, "make_trainer", make_small if make is None else lambda d, r: (make(d, r), {}))
    return loop.train(dataset, out, loop.TrainRun(**run), Progress())  # type: ignore[arg-type]


if __name__ == "__main__":
    from chona_model.cli import main

    loop.make_trainer, loop.LOG_EVERY, loop.CHECKPOINT_SECONDS = make_small, 1, 0.1  # type: ignore[assignment]
    sys.exit(main(sys.argv[1:]))

"""Grid models trained for a few seconds on the tiny capture, shared by the tests of a session."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import torch
from tiny_capture import tiny_capture

from chona_model.data.dataset import Dataset
from chona_model.field.grid import GridShape
from chona_model.grid_model import GridModel, GridModelShape
from chona_model.methods import METHODS, Method
from chona_model.render.tracing import TraceSettings
from chona_model.train.fast_settings import FastSettings
from chona_model.train.grid_trainer import GridTrainer

SHAPE = GridModelShape(
    field=GridShape(levels=4, coarsest=0.12, finest=0.02, rows=12), node_cell=0.06, occupancy_cell=0.03
)
SETTINGS = replace(
    FastSettings(), rays=256, poses=2, cull_from=32, cull_every=16, rebuild=(48, 96), trace=TraceSettings(step=0.02),
    skin_from=0.3,
)  # fmt: skip


def tiny_trainer(dataset: Dataset, seed: int = 0, method: Method = METHODS["chona"]) -> GridTrainer:
    """A trainer of a small model."""
    return GridTrainer(dataset, SETTINGS, seed, method=method, shape=SHAPE)


def trained(steps: int = 500, persons: int = 1, objects: int = 1) -> tuple[Dataset, GridTrainer]:
    """A capture and a trainer after some steps; the same for the same arguments, so leave it as it is."""
    return _trained(steps, persons, objects)


@cache
def _trained(steps: int, persons: int, objects: int) -> tuple[Dataset, GridTrainer]:
    dataset = tiny_capture(Path(mkdtemp()), persons=persons, objects=objects, frames=3, cameras=4, size=(64, 48))
    trainer = tiny_trainer(dataset)
    for index in range(steps):
        trainer.step(index, index / steps)
    return dataset, trainer


def lit(model: GridModel, strength: float = 0.3) -> GridModel:
    """A copy of a model under another light; the tiny capture has hardly any."""
    copy = deepcopy(model)
    with torch.no_grad():
        copy.field.light.copy_(strength * torch.randn(copy.field.light.shape, generator=torch.manual_seed(3)))
    return copy


def unlit(model: GridModel) -> GridModel:
    """A copy of a model without light."""
    return lit(model, 0.0)

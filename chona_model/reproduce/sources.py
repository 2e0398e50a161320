"""The data of a cell: its sequences opened by the readers, frames divided where training and test share a sequence."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from chona_model.data.dataset import Dataset, DatasetError
from chona_model.data.opener import join_datasets, open_dataset
from chona_model.reproduce.tables import Cell

TRAIN_SHARE = 0.7
"""Of a divided sequence's frames; the paper divides them "at random" and says no more."""
DIVISION_SEED = 0


@dataclass(frozen=True)
class CellData:
    """What a cell's model learns from, and its tests by name."""

    train: Dataset
    tests: dict[str, Dataset]


def open_cell(data: Path, cell: Cell, body_model_dir: Path | None, frames: int | None = None) -> CellData:
    """Opens what a cell needs.

    Args:
        data: the folder that holds ``behave``, ``zju_mocap`` and ``co3d``; or BEHAVE's own, where that is all.
        frames: keep so many frames of the training's and of every test's sequences (a dry run); all when None.

    Raises:
        DatasetError: something that the table names is not there.
    """
    train, tests = cell.column.train, dict(cell.column.tests)
    if cell.column.divided:
        train, tests = _divided(data, cell)
    opened = {name: _open(data, sources, body_model_dir) for name, sources in (("", train), *tests.items())}
    if frames is not None:
        opened = {name: _first_frames(dataset, frames) for name, dataset in opened.items()}
    return CellData(opened.pop(""), opened)


def _open(data: Path, sources: Sequence[str], body_model_dir: Path | None) -> Dataset:
    by_format: dict[str, list[str]] = defaultdict(list)
    for source in sources:
        format, _, sequence = source.partition("/")
        by_format[format].append(sequence)
    datasets = [
        open_dataset(data, format, sequences=sequences, body_model_dir=body_model_dir)
        for format, sequences in by_format.items()
    ]
    return datasets[0] if len(datasets) == 1 else join_datasets(datasets)


def _divided(data: Path, cell: Cell) -> tuple[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """Frames of the cell's one sequence, for training and for its one test: as ``splits.json`` says, else by lot."""
    (source,) = cell.column.train
    (test,) = cell.column.tests
    format, _, sequence = source.partition("/")
    file = data / "splits.json"
    if file.is_file():
        try:
            parts = json.loads(file.read_text("utf-8"))[cell.column.divided][sequence]
            train, val = (tuple(map(str, parts[key])) for key in ("train", "val"))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DatasetError(
                f"{file} does not divide {sequence} under '{cell.column.divided}' ({type(error).__name__} {error}); "
                'expected {"train": [frames], "val": [frames]}, or no such file'
            ) from error
    else:
        views = open_dataset(data, format, sequences=[sequence]).views
        frames = sorted({view.frame for view in views})
        order = np.random.default_rng(DIVISION_SEED).permutation(len(frames))
        count = round(TRAIN_SHARE * len(frames))
        train, val = (tuple(sorted(frames[k] for k in part)) for part in (order[:count], order[count:]))
    return tuple(f"{source}/{frame}" for frame in train), {test: tuple(f"{source}/{frame}" for frame in val)}


def _first_frames(dataset: Dataset, frames: int) -> Dataset:
    """Views of the first frames of every identity: none may be missing."""
    seen: dict[tuple[str | None, tuple[str, ...]], set[tuple[str, str]]] = defaultdict(set)
    kept = []
    for view in dataset.views:
        moments = seen[view.pose.person, view.pose.objects]
        if len(moments) < frames or (view.sequence, view.frame) in moments:
            moments.add((view.sequence, view.frame))
            kept.append(view)
    return replace(dataset, views=tuple(kept))

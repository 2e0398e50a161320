"""One cell: a model trained and measured in a folder of its own, so that a table can be continued where it was left."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np

from chona_model.data.dataset import Dataset, View
from chona_model.evaluate.run import evaluate
from chona_model.formats.atomic import write_bytes
from chona_model.formats.folder_lock import lock_folder
from chona_model.formats.picture import save_picture
from chona_model.model_store import load_actor
from chona_model.presets import find_preset
from chona_model.progress import Progress
from chona_model.reproduce.exchange import performed_by, with_objects
from chona_model.reproduce.sources import CellData
from chona_model.reproduce.tables import Cell, TableError
from chona_model.train.checkpoint import NAME as CHECKPOINT
from chona_model.train.run import MODEL, TrainRun, train

RESULT = "result.json"
EXCHANGED_VIEWS = 4
"""Pictures of every exchange of identities."""


@dataclass(frozen=True)
class Protocol:
    """How every cell of a table is made: the same for all methods.

    Attributes:
        minutes, steps: of training, one of them.
        image_scale: size of the images in training and tests.
        preset: of training; quality: of rendering.
        seed: of training; frames: only so many of every identity (a dry run), all when None.
    """

    minutes: float | None = 10.0
    steps: int | None = None
    image_scale: float = 1.0
    preset: str = "fast"
    quality: str = "final"
    seed: int = 0
    frames: int | None = None


def finished(folder: Path, protocol: Protocol) -> dict[str, Any] | None:
    """The result of a cell that was made before; None where there is none.

    Raises:
        TableError: it was made by another protocol.
    """
    path = folder / RESULT
    if not path.is_file():
        return None
    result = json.loads(path.read_text("utf-8"))
    if result["protocol"] != asdict(protocol):
        told = ", ".join(
            f"{key} was {result['protocol'].get(key)}, is {value}"
            for key, value in asdict(protocol).items()
            if result["protocol"].get(key) != value
        )
        raise TableError(f"{folder} was made by another protocol ({told}); give the same one, or another --out")
    return result


def make_cell(
    cell: Cell, data: CellData, folder: Path, protocol: Protocol, progress: Progress, device: str
) -> dict[str, Any] | None:
    """Trains, measures and writes ``result.json`` last; continues a training that was ended.

    Returns:
        the result; None when it was cancelled.

    Raises:
        DatasetError, TrainingError, CheckpointError, OSError: as training and evaluation do.  FolderBusyError: another
            process makes this cell.
    """
    with lock_folder(folder, f"the cell {cell.slug}"):
        return _make_cell(cell, data, folder, protocol, progress, device)


def _make_cell(
    cell: Cell, data: CellData, folder: Path, protocol: Protocol, progress: Progress, device: str
) -> dict[str, Any] | None:
    run = folder / "run"
    trained = folder / "trained"
    if not trained.is_file():
        settings = TrainRun(
            method=cell.row, preset=protocol.preset, minutes=protocol.minutes, steps=protocol.steps,
            image_scale=protocol.image_scale, device=device, seed=protocol.seed, resume=(run / CHECKPOINT).is_file(),
            data_statement=f"{cell.table}, {cell.column_name}: {', '.join(cell.column.train)}",
        )  # fmt: skip
        train(data.train, run, settings, progress)
        if progress.cancelled_by_user:
            return None
        write_bytes(trained, b"")
    model = run / MODEL
    tests = {}
    for name, dataset in data.tests.items():
        report = evaluate(
            model, dataset, protocol.quality, protocol.image_scale, folder / "images" / name.replace(" ", "-"),
            folder / f"{name.replace(' ', '-')}.json", progress, device,
        )  # fmt: skip
        if progress.cancelled_by_user:
            return None
        tests[name] = report["mean"] | {"views": len(report["images"])}
    _exchange(cell, data, model, folder, protocol, device)
    log = [json.loads(line) for line in (run / "log.jsonl").read_text("utf-8").splitlines()]
    result = {
        "table": cell.table, "row": cell.row, "column": cell.column_name, "protocol": asdict(protocol),
        "tests": tests, "steps": log[-1]["step"], "seconds": log[-1]["seconds"],
    }  # fmt: skip
    write_bytes(folder / RESULT, json.dumps(result, indent=1).encode())
    return result


def _exchange(cell: Cell, data: CellData, model: Path, folder: Path, protocol: Protocol, device: str) -> None:
    """Pictures of the tests' interactions with the column's other identities in them."""
    exchanged, scene = cell.column.exchanged, data.train
    persons = [name for name in scene.persons if name in exchanged.persons]
    objects = [name for name in scene.objects if any(fnmatch(name, pattern) for pattern in exchanged.objects)]
    if not persons and not objects:
        return
    actor = load_actor(model, device)
    for name, dataset in data.tests.items():
        for view in _spread(cell.method.dataset(dataset)):
            for label, changed in _changed(view, scene, persons, objects):
                camera = view.camera.scaled(protocol.image_scale)
                picture = actor.render(changed.pose, camera, find_preset(protocol.quality))
                path = folder / "images" / name.replace(" ", "-") / f"{view.label}_{label}.png"
                save_picture(path, picture.rgb)


def _changed(view: View, scene: Dataset, persons: list[str], objects: list[str]) -> list[tuple[str, View]]:
    """The view with one or the other exchanged, by a label."""
    result = []
    for name in persons:
        pose = performed_by(view.pose, scene.skeleton, scene.persons[name])
        result.append((name, replace(view, pose=pose)))
    for name in objects if len(view.pose.objects) == 1 else []:
        result.append((name, replace(view, pose=with_objects(view.pose, (name,)))))
    return result


def _spread(dataset: Dataset) -> list[View]:
    chosen = np.unique(np.linspace(0, len(dataset.views) - 1, EXCHANGED_VIEWS).round().astype(int))
    return [dataset.views[index] for index in chosen]

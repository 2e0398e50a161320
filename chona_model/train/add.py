"""``chona add``: a person or an object seen alone becomes part of a model that exists, by a short training.

The identities that the model has stay as they are, to the bit (see ``grid_growth``); the new ones can then be animated
together with them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from chona_model.data.dataset import Dataset, DatasetError
from chona_model.data.renamed import renamed
from chona_model.formats.model_file import ModelFileError, ModelHeader, file_hash, read_header
from chona_model.grid_actor import GridActor
from chona_model.methods import METHODS, method_of
from chona_model.model_store import load_actor
from chona_model.progress import Progress
from chona_model.train import together
from chona_model.train.fast_settings import FastSettings
from chona_model.train.grid_trainer import GridTrainer
from chona_model.train.repeatable import repeatable
from chona_model.train.run import MODEL, TrainRun, held_folder, report_end, run_trainer, save_model


def add(
    base: Path, dataset: Dataset, names: Mapping[str, str], out: Path, run: TrainRun, progress: Progress,
    settings: FastSettings = FastSettings(),  # noqa: B008 - frozen
) -> Path:  # fmt: skip
    """Trains the dataset's identities ``names`` and writes ``OUT/model.safetensors`` with them and all of ``base``'s.

    Args:
        base: the model file, which is only read.
        names: what is added, by its name in the data, with its name in the model.
        run: how long, and with which seed; the method is the base's. settings: how.

    Returns:
        the model file.

    Raises:
        ModelFileError: the base cannot take new identities. DatasetError: the data do not show them alone.
        TrainingError, CheckpointError, OSError.
    """
    header = read_header(base)
    _check(header, out, names.values())
    dataset = renamed(_shown_alone(dataset, tuple(names), header), names)
    method = METHODS[header.method]
    model = out / MODEL
    with held_folder(out) as held:
        with repeatable(run.device):
            actor = load_actor(base)
            assert isinstance(actor, GridActor)
            trainer = GridTrainer(
                dataset, settings, run.seed, run.image_scale, method, device=run.device, base=actor.model
            )
            identity = {"base": file_hash(base), "method": header.method}
            grown, training = run_trainer(trainer, dataset, out, held, run, identity, progress)
        note = {key: training[key] for key in ("steps", "seconds", "views", "data", "finished")}
        before = header.training
        history = before | {
            "poses_seen": before.get("poses_seen") or training["poses_seen"],
            "added": [*before.get("added", []), {"identities": sorted(names.values()), **note}],
        }
        if together.leads():
            save_model(model, grown, header.method, header.settings, history)
    report_end(progress, model, training)
    return model


def _check(header: ModelHeader, out: Path, names: Iterable[str]) -> None:
    """Raises ModelFileError where the model cannot take anything new."""
    method = method_of(header.method)
    if header.field != "grid" or method.joint:
        raise ModelFileError(
            f"{header.path} keeps all identities in one field (field '{header.field}', method '{header.method}'), "
            "where nothing can be added and leave the others as they are; train a model with --preset fast, or "
            "train all of them together with 'chona train'"
        )
    if method.distances:
        raise ModelFileError(
            f"{header.path} is a model of the method '{header.method}', whose densities are distances from the start; "
            "train all of its identities together with 'chona train'"
        )
    taken = next((name for name in names if name in header.persons or name in header.objects), None)
    if taken is not None:
        raise ModelFileError(
            f"{header.path} holds '{taken}' already; give the new one another name, with --identity {taken}=NEW"
        )
    if (out / MODEL).exists() and (out / MODEL).samefile(header.path):
        raise ModelFileError(
            f"--out is {out}, where the model that is added to lies itself; it stays as it is, so name another folder"
        )


def _shown_alone(dataset: Dataset, names: tuple[str, ...], header: ModelHeader) -> Dataset:
    """The views that show nothing but what is added, in the skeleton of the model."""
    held = [*dataset.persons, *dataset.objects]
    unknown = next((name for name in names if name not in held), None)
    if unknown is not None:
        raise DatasetError(f"there is no '{unknown}' in the data; they hold {', '.join(held) or 'nobody'}")
    if METHODS[header.method].objects == "none" and any(name in dataset.objects for name in names):
        raise DatasetError(
            f"the method '{header.method}' of {header.path} knows no objects; add one to a model of the method chona"
        )
    views = tuple(view for view in dataset.views if {*view.pose.shown} <= set(names) and view.pose.shown)
    for name in names:
        if not any(name in view.pose.shown for view in views):
            with_it = {other for view in dataset.views if name in view.pose.shown for other in view.pose.shown}
            others = ", ".join(sorted(with_it - set(names)))
            raise DatasetError(
                f"no view shows '{name}' without {others or 'others'}; name them as well with --identity, or add it "
                "from views in which it is alone"
            )
    persons = {name: person for name, person in dataset.persons.items() if name in names}
    objects = {name: thing for name, thing in dataset.objects.items() if name in names}
    slots, room = max(len(view.pose.objects) for view in views), int(header.shape["sizes"]["object_slots"])
    if slots > room:
        raise DatasetError(
            f"a view shows {slots} objects at once, and {header.path} was trained for {room}; use views "
            "with fewer, or train all together with 'chona train'"
        )
    if persons and dataset.skeleton != header.skeleton:
        raise DatasetError(
            f"the person has a skeleton of {len(dataset.skeleton)} bones, the model {header.path} one of "
            f"{len(header.skeleton)}, or with other names; capture the person with the model's rig"
        )
    return replace(dataset, skeleton=header.skeleton, persons=persons, objects=objects, views=views)

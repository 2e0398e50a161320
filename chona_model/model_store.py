"""Saving and loading actors as model files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError

from chona_model.actor import Actor
from chona_model.data.dataset import ObjectShape, Person
from chona_model.formats.model_file import FORMAT, VERSION, ModelFileError, ModelHeader, read_header
from chona_model.formats.tensor_file import write_tensors
from chona_model.memory import was_short_of_memory
from chona_model.plain_json import shortened
from chona_model.tensor_reader import IdentityRows, TensorReader


def save_actor(path: Path, actor: Actor, method: str, settings: dict[str, Any], training: dict[str, Any]) -> None:
    """Writes a model file, whole or not at all."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "method": method,
        "field": actor.kind,
        "skeleton": {"names": list(actor.skeleton.names), "parents": list(actor.skeleton.parents)},
        "persons": {name: {"rest_joints": person.rest_joints.tolist()} for name, person in actor.persons.items()},
        "objects": {
            name: {"lower": [float(x) for x in thing.lower], "upper": [float(x) for x in thing.upper]}
            for name, thing in actor.objects.items()
        },
        "object_distance": actor.object_distance,
        "settings": settings,
        "training": training,
        "shape": actor.shape(),
    }
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in actor.tensors().items()}
    write_tensors(path, tensors, {"chona": json.dumps(content)})


@dataclass(frozen=True)
class LoadReport:
    """What of a model file was loaded.

    Attributes:
        persons, objects: names of the identities that were; left: names of those that were not.
        read: bytes taken of each tensor that was touched, by name.
        total_bytes: of all tensors in the file.
    """

    persons: tuple[str, ...]
    objects: tuple[str, ...]
    left: tuple[str, ...]
    read: Mapping[str, int]
    total_bytes: int

    @property
    def bytes_left(self) -> int:
        """Bytes of tensors that were not read."""
        return self.total_bytes - sum(self.read.values())


def load_actor(
    path: Path, device: str = "cpu", persons: Iterable[str] | None = None, objects: Iterable[str] | None = None
) -> Actor:
    """Rebuilds an actor from a model file; see ``load_with_report``."""
    return load_with_report(path, device, persons, objects)[0]


def load_with_report(
    path: Path, device: str = "cpu", persons: Iterable[str] | None = None, objects: Iterable[str] | None = None
) -> tuple[Actor, LoadReport]:
    """Rebuilds an actor from a model file with the persons and objects that are asked for; None for all.

    Nothing of the others is read: no grid, no occupancy, no skinning, no code.  What is rendered is the same to the
    bit; without objects nothing of the pseudo bones is read either.

    Raises:
        ModelFileError: the file is missing, damaged, of another version or of an unknown kind, or it does not hold an
            identity that is asked for; the message names those it holds.
    """
    header = read_header(path)
    chosen_persons = _chosen(path, "person", persons, header.persons)
    chosen_objects = _chosen(path, "object", objects, header.objects)
    if not chosen_persons and not chosen_objects:
        raise ModelFileError(f"neither a person nor an object of {path} is asked for; {_holdings(header)}")
    people = {name: Person(name, header.rest_joints(name)) for name in chosen_persons}
    boxes = ((name, header.objects[name]) for name in chosen_objects)
    things = {name: ObjectShape(name, _corner(box["lower"]), _corner(box["upper"])) for name, box in boxes}
    all_persons, all_objects = list(header.persons), list(header.objects)
    rows = IdentityRows(
        tuple(all_persons.index(name) for name in people), tuple(all_objects.index(name) for name in things),
        len(all_persons), len(all_objects),
    )  # fmt: skip
    try:
        with TensorReader(path) as tensors:
            actor = _kind(header).rebuild(
                header.skeleton, people, things, header.object_distance, header.shape, tensors, device, rows=rows
            )
            left = (*(name for name in all_persons if name not in people),
                    *(name for name in all_objects if name not in things))  # fmt: skip
            return actor, LoadReport(tuple(people), tuple(things), left, dict(tensors.read), tensors.total_bytes)
    except (SafetensorError, LookupError, TypeError, ValueError, RuntimeError, OverflowError, MemoryError) as error:
        if was_short_of_memory(error):
            raise MemoryError(str(error)) from error
        raise ModelFileError(
            f"{path} does not hold the tensors its metadata names ({shortened(error)}); copy it again"
        ) from error


def _kind(header: ModelHeader) -> Any:
    """The class of the actor; imported only when it is needed."""
    if header.field == "grid":
        from chona_model.grid_actor import GridActor

        return GridActor
    if header.field == "exact":
        from chona_model.exact_actor import ExactActor

        return ExactActor
    raise ModelFileError(
        f"{header.path} holds a field of kind '{header.field}', this program knows grid and exact: update it"
    )


def _chosen(path: Path, kind: str, asked: Iterable[str] | None, held: Mapping[str, Any]) -> list[str]:
    """The identities asked for, in the file's order."""
    if asked is None:
        return list(held)
    names = set(asked)
    unknown = sorted(names - set(held))
    if unknown:
        raise ModelFileError(f"{path} holds no {kind} '{unknown[0]}'; it holds: {', '.join(held) or 'none'}")
    return [name for name in held if name in names]


def _holdings(header: ModelHeader) -> str:
    return f"it holds the persons {', '.join(header.persons) or 'none'} and the objects " \
           f"{', '.join(header.objects) or 'none'}"  # fmt: skip


def _corner(values: list[float]) -> Any:
    import numpy as np

    return np.array(values, dtype=np.float64)

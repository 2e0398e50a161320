"""Saving and loading actors as model files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from chona_model.actor import Actor
from chona_model.data.dataset import ObjectShape, Person
from chona_model.formats.atomic import atomic_path
from chona_model.formats.model_file import FORMAT, VERSION, ModelFileError, read_header


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
    with atomic_path(path) as temporary:
        save_file(
            {name: tensor.detach().cpu().contiguous() for name, tensor in actor.tensors().items()},
            temporary,
            metadata={"chona": json.dumps(content)},
        )


def load_actor(path: Path, device: str = "cpu") -> Actor:
    """Rebuilds an actor from a model file.

    Raises:
        ModelFileError: the file is missing, damaged, of another version or of an unknown kind.
    """
    header = read_header(path)
    persons = {name: Person(name, header.rest_joints(name)) for name in header.persons}
    objects = {name: ObjectShape(name, _corner(v["lower"]), _corner(v["upper"])) for name, v in header.objects.items()}
    try:
        tensors = load_file(path, device="cpu")
        if header.field == "grid":
            from chona_model.grid_actor import GridActor

            return GridActor.rebuild(
                header.skeleton, persons, objects, header.object_distance, header.shape, tensors, device
            )
        if header.field == "exact":
            from chona_model.exact_actor import ExactActor

            return ExactActor.rebuild(
                header.skeleton, persons, objects, header.object_distance, header.shape, tensors, device
            )
    except (SafetensorError, KeyError, TypeError, RuntimeError) as error:
        raise ModelFileError(f"{path} does not hold the tensors its metadata names ({error}); copy it again") from error
    raise ModelFileError(f"{path} holds a field of kind '{header.field}', this program knows grid and exact: update it")


def _corner(values: list[float]) -> Any:
    import numpy as np

    return np.array(values, dtype=np.float64)

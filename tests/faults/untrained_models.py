"""Model files of both kinds without any training: what their readers check is all there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from chona_model.data.dataset import ObjectShape, Person
from chona_model.deform.skinning import DeformShape
from chona_model.exact import ExactModel
from chona_model.exact_actor import ExactActor
from chona_model.exact_shape import ExactShape
from chona_model.field.grid import GridShape
from chona_model.field.radiance import FieldShape
from chona_model.formats.model_file import write_trade
from chona_model.grid_actor import GridActor
from chona_model.grid_model import GridModel, GridModelShape
from chona_model.model_store import save_actor
from chona_model.skeleton import Skeleton

SKELETON = Skeleton(("hips", "chest", "head"), (-1, 0, 1))
JOINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.55, 0.03]])
BOX = np.array([0.1, 0.08, 0.12])
TRAINING = {"steps": 7, "data": "a capture", "views": 2}
TRADE = {
    "version": 1, "size": [32, 24], "views": 2, "machine": {"cores": 2},
    "presets": {name: {"seconds": 0.1, "fixed_seconds": 0.01, "seconds_per_ray": 1e-5, "psnr": 30.0, "ssim": 0.9}
                for name in ("draft", "final")},
    "reference": {"person": "Sub01", "objects": ["box01"], "world_from_bone": [np.eye(4).tolist()] * 3,
                  "world_from_object": [np.eye(4).tolist()], "intrinsics": [[50, 0, 16], [0, 50, 12], [0, 0, 1]],
                  "world_from_camera": np.eye(4).tolist(), "width": 32, "height": 24, "kind": "PERSP"},
}  # fmt: skip


def write_grid_model(path: Path, person: str = "Sub01", thing: str = "box01") -> Path:
    """A model on grids of one person and one object, tens of kilobytes."""
    shape = GridModelShape(
        field=GridShape(levels=4, coarsest=0.3, finest=0.1, rows=6), node_cell=0.25, node_reach=0.3,
        occupancy_cell=0.2, offset_rank=2,
    )  # fmt: skip
    torch.manual_seed(0)
    model = GridModel(SKELETON, {person: Person(person, JOINTS)}, {thing: ObjectShape(thing, -BOX, BOX)}, 0.8, shape)
    model.occupancy.densities[:], model.occupancy.support[:] = 1.0, True
    save_actor(path, GridActor(model), "chona", {"preset": "fast"}, TRAINING)
    write_trade(path, TRADE)
    return path


def write_exact_model(path: Path, person: str = "Sub01", thing: str = "box01") -> Path:
    """A model of the paper's path with small networks."""
    corner = (float(BOX[0]), float(BOX[1]), float(BOX[2]))
    below = (-corner[0], -corner[1], -corner[2])
    shape = ExactShape(
        bones=3, object_slots=1, n_persons=1, n_objects=1, lower=(-1.0, -1.0, -1.0), upper=(1.0, 1.0, 1.5),
        object_distance=0.8, code_size=4, object_lower=(below,), object_upper=(corner,),
        deform=DeformShape(degrees=2, width=8, depth=2),
        radiance=FieldShape(degrees=2, width=8, depth=3, skip=1, head_width=8),
    )  # fmt: skip
    torch.manual_seed(0)
    people, things = {person: Person(person, JOINTS)}, {thing: ObjectShape(thing, -BOX, BOX)}
    actor = ExactActor(ExactModel(shape), SKELETON, people, things, 0.8)
    save_actor(path, actor, "chona", {"preset": "paper"}, TRAINING)
    write_trade(path, TRADE)
    return path

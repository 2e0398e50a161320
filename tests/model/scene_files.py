"""A model file of several persons and objects, and shots of some of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import torch
from tiny_capture import SKELETON, tiny_capture
from tiny_models import lit, tiny_trainer

from chona_model.camera import Camera
from chona_model.data.dataset import Dataset, Pose
from chona_model.formats.shot import Shot, ShotActor, write_shot
from chona_model.grid_actor import GridActor
from chona_model.model_store import save_actor
from chona_model.skeleton import translation

STEPS = 60
NO_BONES, NO_OBJECTS = np.zeros((0, 4, 4)), np.zeros((0, 4, 4))

PLACES = {"behind": (0.0, 0.0, -2.0), "right": (4.0, 0.0, 2.0), "above": (0.0, -3.0, 2.0), "beside": (2.5, 0.0, 0.0)}
"""Places in camera space that no picture here shows, metres."""


@cache
def grid_file() -> tuple[Path, Dataset]:
    """A model of Sub01, Sub02, box01, box02 and box03 whose offset and light are large enough to be seen."""
    dataset = tiny_capture(Path(mkdtemp()), persons=2, objects=3, frames=1, cameras=2, size=(48, 36))
    trainer = tiny_trainer(dataset)
    for step in range(STEPS):
        trainer.step(step, step / STEPS)
    actor = GridActor(lit(trainer.model))
    with torch.no_grad():
        for index in range(2):
            actor.model.volume(index).offset_shapes.normal_(std=0.01, generator=torch.manual_seed(index))
    path = Path(mkdtemp()) / "model.safetensors"
    save_actor(path, actor, "chona", {}, {})
    return path, dataset


def without_objects(pose: Pose) -> Pose:
    return Pose(pose.person, (), pose.world_from_bone, NO_OBJECTS)


def without_person(pose: Pose) -> Pose:
    return Pose(None, pose.objects, NO_BONES, pose.world_from_object)


def moved(matrices: np.ndarray, camera: Camera, place: tuple[float, float, float]) -> np.ndarray:
    """Frames moved together so that the first lies at ``place`` in camera space, metres."""
    way = camera.world_from_camera[:3, :3] @ np.array(place) + camera.world_from_camera[:3, 3] - matrices[0, :3, 3]
    return translation(way) @ matrices


def write_poses(path: Path, camera: Camera, *actors: Sequence[Pose], name: str = "walk") -> Path:
    """A shot from frame 1 on; each actor, called after its person or first object, has a pose a frame."""
    count = len(actors[0])
    members = tuple(
        ShotActor(
            poses[0].person or poses[0].objects[0], poses[0].person, poses[0].objects,
            SKELETON.names if poses[0].person else (), np.stack([pose.world_from_bone for pose in poses]),
            np.stack([pose.world_from_object for pose in poses]),
        )
        for poses in actors
    )  # fmt: skip
    write_shot(path, Shot(
        name, 24.0, camera.width, camera.height, camera.kind, np.arange(1, count + 1),
        np.stack([camera.intrinsics] * count), np.stack([camera.world_from_camera] * count),
        np.array([[0.01, 100.0]] * count), members,
    ))  # fmt: skip
    return path

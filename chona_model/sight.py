"""What a frame of a shot spares: who is out of the picture, and which bones are at rest.

All from the shot and a model file's header: no tensor is read for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from chona_model.camera import Camera
from chona_model.deform.voxels import moving_bones
from chona_model.figure import Rig, make_figure
from chona_model.formats.model_file import ModelHeader
from chona_model.formats.shot import Shot, ShotActor
from chona_model.render.bounds import BODY_REACH, OBJECT_MARGIN
from chona_model.render.sides import depth_inside


@dataclass(frozen=True, order=True)
class Unseen:
    """A person or an object of one actor that no pixel of a frame can show.

    Attributes:
        actor: as the scene calls it; name: of the identity.
    """

    actor: str
    name: str


def shown_identities(actors: Sequence[ShotActor]) -> tuple[list[str], list[str]]:
    """Names of the persons and of the objects that actors show at all."""
    persons = {member.person for member in actors if member.person is not None}
    return sorted(persons), sorted({name for member in actors for name in member.objects})


def out_of_picture(shot: Shot, index: int, headers: Sequence[ModelHeader]) -> list[Unseen]:
    """Who of the frame at ``index`` is surely beside, above, below or behind the camera's picture.

    A body reaches ``BODY_REACH`` beyond its bones, an object ``OBJECT_MARGIN`` beyond its box.

    Args:
        headers: of every actor's model.
    """
    camera, found = shot.camera(index), []
    for member, header in zip(shot.actors, headers, strict=True):
        if member.person is not None and _bones_outside(member, index, header, camera):
            found.append(Unseen(member.name, member.person))
        for slot, name in enumerate(member.objects):
            box = header.objects[name]
            corners = np.stack(np.meshgrid(*zip(box["lower"], box["upper"], strict=True)), axis=-1).reshape(-1, 3)
            if _outside(_in_camera(corners, member.world_from_object[index, slot], camera), camera, OBJECT_MARGIN):
                found.append(Unseen(member.name, name))
    return found


def bones_at_rest(shot: Shot, index: int, headers: Sequence[ModelHeader]) -> tuple[int, int]:
    """How many bones of the frame's persons stand to their root as in the canonical pose, and of how many.

    The roots themselves are not counted: they always do. Nor are models on the paper's path, which fold no bones.

    Args:
        headers: of every actor's model.
    """
    still = total = 0
    for member, header in zip(shot.actors, headers, strict=True):
        if member.person is not None and header.field == "grid":
            rig = Rig(header.skeleton, header.rest_joints(member.person), header.object_distance)
            figure = make_figure(rig, member.world_from_bone[index], np.zeros((0, 4, 4)), 0)
            transforms = torch.as_tensor(figure.transforms, dtype=torch.float32)
            total += len(transforms) - 1
            still += len(transforms[1:]) - len(moving_bones(transforms[1:])[1])
    return still, total


def _bones_outside(member: ShotActor, index: int, header: ModelHeader, camera: Camera) -> bool:
    rest = header.rest_joints(str(member.person))
    ends = np.stack([np.zeros_like(rest), header.skeleton.bone_tails(rest) - rest], axis=1)
    frames = member.world_from_bone[index]
    return all(
        _outside(_in_camera(pair, frame, camera), camera, BODY_REACH) for pair, frame in zip(ends, frames, strict=True)
    )


def _in_camera(points: np.ndarray, world_from_own: np.ndarray, camera: Camera) -> np.ndarray:
    """Points [K, 3] in camera space; the way from the camera is taken before it is turned, as worlds are large."""
    way = world_from_own[:3, 3] - camera.world_from_camera[:3, 3]
    return (points @ world_from_own[:3, :3].T + way) @ camera.world_from_camera[:3, :3]


def _outside(corners: np.ndarray, camera: Camera, reach: float) -> bool:
    """Whether all corners [K, 3] of a convex body, and all within ``reach`` of it, lie beyond one side."""
    return bool((depth_inside(corners, camera) < -reach).all(axis=0).any())

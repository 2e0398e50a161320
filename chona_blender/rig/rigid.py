"""Rigid frames of sampled matrices, and the figure's own scale taken out of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..camera import CameraSample
from ..errors import ChonaError
from .rest_pose import RestPose
from .sampling import Samples
from .validation import STRETCH_LIMIT, Dropped, figure_scale, project_rotations


@dataclass(frozen=True)
class RigidPose:
    """Rigid frames as in docs/conventions.md, in metres of the *figure*: Blender's world divided by ``scale``.

    Attributes:
        world_from_bone: [F, B, 4, 4].
        world_from_object: [F, N, 4, 4].
        scale: the figure's uniform scale; 1 for a figure of natural size.
        dropped: scale and shear that was dropped, a bone or object each, the worst first.
    """

    world_from_bone: np.ndarray
    world_from_object: np.ndarray
    scale: float
    dropped: tuple[Dropped, ...]


def rigid_pose(
    samples: Samples,
    rest: RestPose | None,
    names: Sequence[str],
    object_names: Sequence[str],
    *,
    limit: float | None = STRETCH_LIMIT,
    object_limit: float | None = STRETCH_LIMIT,
) -> RigidPose:
    """Rigid bone and object frames of sampled matrices.

    The canonical frame of a bone is a pure translation to its rest joint, so ``world_from_bone`` takes the rotation of
    ``world_from_armature`` after the rest pose's axes, and its position is where the bone's head is.

    Args:
        rest: of the armature the bones were sampled from; None without an armature.
        names, object_names: for messages; the model's bone names and objects.
        limit, object_limit: largest stretch that is dropped; None drops any.

    Raises:
        ChonaError: not finite, zero scale, mirrored, or stretched past the limit, by name and frame.
    """
    frames = samples.frames
    empty = np.empty((len(frames), 0, 4, 4))
    linear = samples.world_from_object[..., :3, :3]
    dropped: list[Dropped] = []
    if rest is not None and rest.bones:
        bones = samples.world_from_armature[..., :3, :3] @ (rest.rotation * rest.scale)
        scale = figure_scale(bones) if np.isfinite(bones).all() else 1.0
        rotations, dropped = project_rotations(
            bones, scale if scale > 0 else 1.0, "Bone", names=names, frames=frames, limit=limit
        )
        heads = np.einsum("fbij,bj->fbi", samples.world_from_armature[..., :3, :3], rest.heads)
        world_from_bone = _homogeneous(rotations, (heads + samples.world_from_armature[..., :3, 3]) / scale)
    else:
        scale = figure_scale(linear) if np.isfinite(linear).all() else 1.0
        scale = scale if scale > 0 and object_limit is not None else 1.0
        world_from_bone = empty
    world_from_object, more = objects_pose(samples, object_names, scale, object_limit)
    if not np.isfinite(world_from_bone).all():
        raise ChonaError("The position of a bone is not finite. Check constraints and drivers")
    return RigidPose(world_from_bone, world_from_object, scale, (*dropped, *more))


def objects_pose(
    samples: Samples, object_names: Sequence[str], scale: float, limit: float | None
) -> tuple[np.ndarray, list[Dropped]]:
    """Rigid frames [F, N, 4, 4] of sampled objects in the world divided by ``scale``, and what was dropped.

    Raises:
        ChonaError: see ``rigid_pose``.
    """
    linear = samples.world_from_object[..., :3, :3]
    rotations, dropped = project_rotations(
        linear, scale, "Object", names=object_names, frames=samples.frames, limit=limit
    )
    placed = _homogeneous(rotations, samples.world_from_object[..., :3, 3] / scale)
    if not np.isfinite(placed).all():
        raise ChonaError("The position of an object is not finite. Check constraints and drivers")
    return placed, dropped


def rescale_camera(sample: CameraSample, scale: float) -> CameraSample:
    """The same view of a world that is divided by ``scale``."""
    matrix, intrinsics = sample.world_from_camera.copy(), sample.intrinsics.copy()
    matrix[:3, 3] /= scale
    if sample.kind == "ORTHO":
        intrinsics[[0, 1], [0, 1]] *= scale
    lens = replace(sample.lens, focus_distance=sample.lens.focus_distance / scale, radius=sample.lens.radius / scale)
    return CameraSample(intrinsics, matrix, sample.clip / scale, sample.kind, lens)


def _homogeneous(rotations: np.ndarray, positions: np.ndarray) -> np.ndarray:
    matrices = np.zeros((*positions.shape[:-1], 4, 4))
    matrices[..., :3, :3] = rotations
    matrices[..., :3, 3] = positions
    matrices[..., 3, 3] = 1.0
    return matrices

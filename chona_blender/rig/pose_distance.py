"""How far a performance is from the poses that a model has seen in training, as its file tells them.

A figure in a pose like those of its training looks like its pictures; far from them the model guesses.  The distance
of a frame is taken to the nearest of the poses in the file: the angle by which joints differ, RMS over the body.  A
joint by itself is *outside* where it is turned further than the nearest kept pose and the gap that training poses
leave explain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .rotations import angle_of, matrices_of

MARGIN = np.radians(10.0)
"""Joints this much beyond the training poses still look right, and a radius is never taken for less."""

FULL = np.radians(45.0)
"""A joint so far outside is as bad as it gets."""


@dataclass(frozen=True)
class PosesSeen:
    """The training poses of a model, as ``chona_model`` summarises them.

    Attributes:
        bones: J joints, those with a parent.
        poses: [K, J, 3, 3] kept rotations against the parent.
        radius: largest distance of a training pose from the nearest kept one, radians.
        spacing: [J] the same, joint by joint.
        turned: [J] largest rotation against the rest pose, radians.
        count: number of training poses.
    """

    bones: tuple[str, ...]
    poses: np.ndarray
    radius: float
    spacing: np.ndarray
    turned: np.ndarray
    count: int


@dataclass(frozen=True)
class PoseDistance:
    """A performance against the training poses.

    Attributes:
        distance: [F] of the whole body, radians.
        outside: [F, J] how far each joint is outside, radians; 0 inside.
        level: [F] 0 as in training … 1 as far as it matters.
    """

    distance: np.ndarray
    outside: np.ndarray
    level: np.ndarray


def read_poses_seen(description: Mapping[str, Any]) -> PosesSeen | None:
    """From a model's description; None where it has no record, or one that cannot be read."""
    training = description.get("training")
    record = training.get("poses_seen") if isinstance(training, Mapping) else None
    if not isinstance(record, Mapping) or record.get("version") != 1:
        return None
    try:
        bones = tuple(str(name) for name in record["bones"])
        vectors = np.array(record["poses"], dtype=np.float64).reshape(-1, len(bones), 3)
        spacing, turned = (np.array(record[key], dtype=np.float64) for key in ("spacing", "turned"))
        seen = PosesSeen(bones, matrices_of(vectors), float(record["radius"]), spacing, turned, int(record["count"]))
    except (KeyError, TypeError, ValueError):
        return None
    shapes = spacing.shape == turned.shape == (len(bones),)
    finite = np.isfinite(vectors).all() and np.isfinite([seen.radius, *spacing, *turned]).all()
    return seen if bones and len(vectors) and shapes and finite else None


def pose_distance(
    seen: PosesSeen, names: Sequence[str], parents: Sequence[int], world_from_bone: np.ndarray
) -> PoseDistance:
    """Compares frames with the training poses.

    Args:
        names, parents: of the model's B bones.
        world_from_bone: [F, B, 4, 4] rigid.
    """
    places = [list(names).index(bone) for bone in seen.bones]
    above = [parents[place] for place in places]
    rotations = world_from_bone[..., :3, :3]
    local = np.swapaxes(rotations[:, above], -1, -2) @ rotations[:, places]
    distance = np.full(len(local), np.inf)
    nearest = np.full(local.shape[:2], np.inf)
    for pose in seen.poses:
        angles = angle_of(np.swapaxes(pose, -1, -2) @ local)
        distance = np.minimum(distance, np.sqrt((angles**2).mean(axis=-1)))
        nearest = np.minimum(nearest, angles)
    outside = np.maximum(nearest - seen.spacing - MARGIN, 0.0)
    radius = max(seen.radius, MARGIN)
    whole = (distance - radius) / (2.0 * radius)
    level = np.clip(np.maximum(whole, outside.max(axis=-1) / FULL), 0.0, 1.0)
    return PoseDistance(distance, outside, level)

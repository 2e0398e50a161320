"""Which poses a model has been trained on, small enough to travel in its file.

The add-on compares a performance with it, frame by frame and joint by joint, and shows where quality will fall.  What
is kept: a few dozen poses that lie as far apart as possible (farthest point sampling), so that every training pose is
near one of them; for every joint how near; and how far it was turned at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from chona_model.data.dataset import Dataset

VERSION = 1
MOST_POSES = 64
MOST_NUMBERS = 4500
"""Of all kept rotations together: some 30 kB of JSON, whatever the skeleton."""

CLOSE = np.radians(1.0)
"""Poses nearer to a kept one than this (RMS over joints) add nothing."""


def poses_seen(dataset: Dataset) -> dict[str, Any] | None:
    """The summary of a dataset's poses for the model file, or None where it holds no person.

    Returns:
        ``bones``: names of the J joints that have a parent; ``poses``: kept poses as rotation vectors [K, J, 3]
        against the parent, radians; ``radius``: largest distance of a training pose from the nearest kept one, RMS
        over joints; ``spacing`` [J]: the same for each joint by itself, largest angle; ``turned`` [J]: largest
        rotation against the rest pose; ``count``: number of training poses; ``version``.
    """
    frames = {
        (view.sequence, view.frame): view.pose.world_from_bone for view in dataset.views if view.pose.person is not None
    }
    if not frames:
        return None
    return summarise(dataset.skeleton.names, dataset.skeleton.parents, np.stack(list(frames.values())))


def summarise(names: Sequence[str], parents: Sequence[int], world_from_bone: np.ndarray) -> dict[str, Any]:
    """See ``poses_seen``.

    Args:
        names, parents: of B bones, -1 for the root.
        world_from_bone: [P, B, 4, 4] rigid.
    """
    local = local_rotations(parents, world_from_bone)
    joints = [index for index, parent in enumerate(parents) if parent >= 0]
    local = local[:, joints]
    most = max(1, min(MOST_POSES, MOST_NUMBERS // max(3 * len(joints), 1)))
    kept, angles = _farthest(local, most)
    return {
        "version": VERSION,
        "bones": [names[index] for index in joints],
        "poses": np.round(rotation_vectors(local[kept]), 3).tolist(),
        "radius": round(float(_rms(angles).max(initial=0.0)), 4),
        "spacing": np.round(_nearest_by_joint(local, local[kept]).max(axis=0, initial=0.0), 4).tolist(),
        "turned": np.round(_angles(local, np.eye(3)).max(axis=0, initial=0.0), 4).tolist(),
        "count": len(local),
    }


def local_rotations(parents: Sequence[int], world_from_bone: np.ndarray) -> np.ndarray:
    """Rotations [P, B, 3, 3] of bones against their parents; the root's against the world."""
    rotations = world_from_bone[..., :3, :3]
    local = rotations.copy()
    for index, parent in enumerate(parents):
        if parent >= 0:
            local[:, index] = np.swapaxes(rotations[:, parent], -1, -2) @ rotations[:, index]
    return local


def rotation_vectors(rotations: np.ndarray) -> np.ndarray:
    """Axis times angle [..., 3] of rotations [..., 3, 3], radians; exact at half a turn as at none."""
    # A quaternion from the largest of its four components: no division by what is small.
    m = rotations
    diagonal = np.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], axis=-1)
    trace = diagonal.sum(-1)
    squares = np.concatenate([(1.0 + trace)[..., None], 1.0 + 2.0 * diagonal - trace[..., None]], axis=-1)
    skew = np.stack([m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1)
    rows = np.empty((*trace.shape, 4, 4))
    rows[..., 0, 0], rows[..., 0, 1:], rows[..., 1:, 0] = squares[..., 0], skew, skew
    rows[..., 1:, 1:] = m + np.swapaxes(m, -1, -2)
    for axis in range(3):
        rows[..., axis + 1, axis + 1] = squares[..., axis + 1]
    largest = squares.argmax(axis=-1)[..., None, None]
    quaternion = np.take_along_axis(rows, largest, axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion = np.where(quaternion[..., :1] < 0.0, -quaternion, quaternion)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternion[..., :1])
    return quaternion[..., 1:] * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 2.0)


def _angles(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angles [...] between rotations [..., 3, 3], exact for small ones: a chord's half is the sine of half the
    angle."""
    chord = np.sqrt(((one - other) ** 2).sum((-2, -1)) / 8.0)
    return 2.0 * np.arcsin(np.minimum(chord, 1.0))


def _rms(angles: np.ndarray) -> np.ndarray:
    """Over joints: [P, J] → [P]."""
    return np.sqrt((angles**2).mean(axis=-1)) if angles.shape[-1] else np.zeros(len(angles))


def _farthest(local: np.ndarray, most: int) -> tuple[list[int], np.ndarray]:
    """Indices of poses far apart, and for every pose the angles [P, J] to the kept one that is nearest as a whole."""
    kept = [int(_rms(_angles(local, local.mean(axis=0))).argmin())]  # the one in the middle
    angles = _angles(local, local[kept[0]])
    while len(kept) < most:
        distance = _rms(angles)
        farthest = int(distance.argmax())
        if distance[farthest] < CLOSE:
            break
        kept.append(farthest)
        fresh = _angles(local, local[farthest])
        nearer = _rms(fresh) < distance
        angles = np.where(nearer[:, None], fresh, angles)
    return kept, angles


def _nearest_by_joint(local: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """For every pose and joint the angle [P, J] to the nearest of the kept rotations of that joint."""
    nearest = np.full(local.shape[:2], np.inf)
    for pose in kept:
        nearest = np.minimum(nearest, _angles(local, pose))
    return nearest

"""Bounds of a posed figure from its bones and object boxes: where the exact path samples at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.figure import Figure, Rig
from chona_model.kernels.marching import splat_spans
from chona_model.render.posed import camera_matrix
from chona_model.render.sides import touches_picture

BODY_REACH = 0.22
"""Nothing of a body is farther from its bones than this, metres: flesh, clothes, hair and the offset."""

OBJECT_MARGIN = 0.03
"""Nothing of an object is farther from its given box than this, metres."""

SPACING = 0.04
"""Between the points that stand for a bone or a box, metres."""

Box = tuple[np.ndarray, np.ndarray]


def figure_spans(figure: Figure, rig: Rig, boxes: Sequence[Box], camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Near and far depth of every pixel, [H, W] float32 each; far ≤ near where the ray misses the figure.

    Args:
        boxes: lower and upper corners of each present object in its own frame, in slot order.
    """
    near = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    far = np.zeros((camera.height, camera.width), dtype=np.float32)
    matrix = camera_matrix(figure, camera)
    bones = len(rig.skeleton)
    if figure.present[0]:
        points = _posed(figure.transforms[:bones], _bone_points(rig))
        _splat(points, matrix, camera, BODY_REACH + rig.reach + 0.5 * SPACING, near, far)
    places = rig.canonical_objects(len(boxes))
    for slot, box in enumerate(boxes):
        points = _box_points(box) + places[slot]
        points = _posed(figure.transforms[bones + slot][None], points[None])
        # A cell's half diagonal: every point of the box is within it of a sample.
        _splat(points, matrix, camera, OBJECT_MARGIN + 0.87 * SPACING, near, far)
    return near, far


def _splat(
    points: np.ndarray, matrix: np.ndarray, camera: Camera, reach: float, near: np.ndarray, far: np.ndarray
) -> None:
    """Spans of pixels that see within ``reach`` of points [M, 3] in root space; points beside the camera have none."""
    touching = touches_picture(points.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3], reach, camera)
    splat_spans(points[touching], matrix, camera.intrinsics, camera.kind == ORTHOGRAPHIC, reach, near, far)


def _bone_points(rig: Rig) -> np.ndarray:
    """[B, K, 3] points along every bone, canonical, metres."""
    tails = rig.skeleton.bone_tails(rig.rest_joints)
    longest = np.linalg.norm(tails - rig.rest_joints, axis=-1).max()
    share = np.linspace(0.0, 1.0, int(np.ceil(longest / SPACING)) + 1)
    return rig.rest_joints[:, None] + share[None, :, None] * (tails - rig.rest_joints)[:, None]


def _box_points(box: Box) -> np.ndarray:
    """[K, 3] a lattice over a box, corners included."""
    axes = [np.linspace(a, b, int(np.ceil((b - a) / SPACING)) + 1) for a, b in zip(*box, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _posed(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [J, K, 3] by transforms [J, 4, 4], as [J · K, 3] float32."""
    moved = np.einsum("jab,jkb->jka", transforms[:, :3, :3], points) + transforms[:, None, :3, 3]
    return moved.reshape(-1, 3).astype(np.float32)

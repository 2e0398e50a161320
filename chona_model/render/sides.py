"""The planes that bound what a camera sees: what lies beyond one of them is in no pixel."""

from __future__ import annotations

import numpy as np

from chona_model.camera import ORTHOGRAPHIC, Camera

MARGIN = 1.0
"""Pixels around the image that still count as seen."""


def picture_sides(camera: Camera) -> np.ndarray:
    """[5, 4] planes in camera space: a point's ``normal · point + offset`` is its depth inside each, metres.

    Left, right, top and bottom of the image and the camera's own plane.  Normals have length one.
    """
    planes = [np.array([0.0, 0.0, 1.0, 0.0])]
    for axis, size in ((0, camera.width), (1, camera.height)):
        focal, centre = camera.intrinsics[axis, axis], camera.intrinsics[axis, 2]
        for sign, room in ((1.0, centre + MARGIN), (-1.0, size - centre + MARGIN)):
            plane = np.zeros(4)
            plane[axis] = sign * focal
            plane[3 if camera.kind == ORTHOGRAPHIC else 2] = room
            planes.append(plane / np.linalg.norm(plane[:3]))
    return np.stack(planes)


def depth_inside(points: np.ndarray, camera: Camera) -> np.ndarray:
    """[..., 5] how far points [..., 3] in camera space lie inside each side of the picture, metres; negative: outside.

    A sphere is in no pixel where one of its five is less than minus its radius; a convex body, where one is so for all
    of its corners.
    """
    sides = picture_sides(camera)
    return points @ sides[:, :3].T + sides[:, 3]


def touches_picture(points: np.ndarray, reach: float, camera: Camera) -> np.ndarray:
    """[K] bool: points [K, 3] in camera space with a pixel's ray within ``reach`` metres of them, or almost.

    What stands beside the camera is not in its picture, however near it is.
    """
    sides = picture_sides(camera)
    # Side by side: a reduction over [K, 5] takes many times as long.
    touched = np.ones(len(points), dtype=bool)
    for side in sides:
        touched &= points @ side[:3] + side[3] > -reach
    return touched

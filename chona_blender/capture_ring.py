"""Cameras in rings around what is captured: where they stand in closed form, and as objects while it is rendered."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import Object
from mathutils import Matrix

from .errors import ChonaError

MARGIN = 0.2
"""Metres around the joints: flesh, hair and hands are outside of them."""
HALF_SENSOR = 18.0
"""Millimetres: half of the longer side."""


@dataclass(frozen=True)
class Ring:
    """How cameras stand around a performance.

    Attributes:
        count: cameras of a ring, at equal angles; the first one looks at the face.
        rings: how many, one above the other; those of every second one stand in between.
        radius: metres; 0 fits it so that everything is seen.
        height: metres of the rings' middle over the performance's.
        spacing: metres between two rings.
        lens: millimetres on a sensor of 36 mm.
        stagger: every second camera is raised by this angle, radians.
    """

    count: int = 8
    rings: int = 1
    radius: float = 0.0
    height: float = 0.0
    spacing: float = 0.8
    lens: float = 40.0
    stagger: float = 0.25

    @property
    def cameras(self) -> int:
        """In all rings."""
        return self.count * self.rings


@dataclass(frozen=True)
class Space:
    """Where the performance takes place, metres in Blender's world: the middle [3], and the farthest from it.

    Attributes:
        reach: distance of the farthest joint with its flesh; across: the same, seen from above.
    """

    middle: np.ndarray
    reach: float
    across: float

    @staticmethod
    def around(points: np.ndarray) -> Space:
        """Of points [..., 3]."""
        flat = points.reshape(-1, 3)
        middle = (flat.min(axis=0) + flat.max(axis=0)) / 2.0
        away = flat - middle
        return Space(
            middle,
            float(np.linalg.norm(away, axis=1).max()) + MARGIN,
            float(np.linalg.norm(away[:, :2], axis=1).max()) + MARGIN,
        )


def tangents(lens: float, width: int, height: int) -> tuple[float, float]:
    """Of half the angles that are seen, across and upright."""
    longer = HALF_SENSOR / lens
    return longer * min(width / height, 1.0), longer * min(height / width, 1.0)


def ring_radius(ring: Ring, space: Space, width: int, height: int) -> float:
    """Metres: as set, or so large that a ball around everything fits into the picture."""
    if ring.radius > 0.0:
        return ring.radius
    return float(space.reach / np.sin(np.arctan(min(tangents(ring.lens, width, height)))))


def ring_poses(ring: Ring, space: Space, width: int, height: int) -> np.ndarray:
    """[C, 4, 4] world_from_camera in Blender's axes (looking down −z, y up), ring by ring from the lowest."""
    radius = ring_radius(ring, space, width, height)
    poses = np.broadcast_to(np.eye(4), (ring.cameras, 4, 4)).copy()
    for index in range(ring.cameras):
        level, place = divmod(index, ring.count)
        angle = 2.0 * np.pi * (place + 0.5 * (level % 2)) / ring.count - np.pi / 2.0  # figures face −y
        tilt = ring.stagger * (place % 2)
        offset = radius * np.array([np.cos(angle) * np.cos(tilt), np.sin(angle) * np.cos(tilt), np.sin(tilt)])
        offset[2] += ring.height + ring.spacing * (level - (ring.rings - 1) / 2.0)
        back = offset / np.linalg.norm(offset)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        poses[index, :3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
        poses[index, :3, 3] = space.middle + offset
    return poses


def cut_off(poses: np.ndarray, points: np.ndarray, lens: float, width: int, height: int) -> np.ndarray:
    """[C] bool: cameras that do not see all of the points [..., 3]."""
    flat = points.reshape(-1, 3)
    across, upright = tangents(lens, width, height)
    local = np.einsum("cij,cpi->cpj", poses[:, :3, :3], flat[None] - poses[:, None, :3, 3])
    depth = -local[..., 2]
    seen = (depth > 0.0) & (np.abs(local[..., 0]) <= across * depth) & (np.abs(local[..., 1]) <= upright * depth)
    return ~seen.all(axis=1)


def check_ring(ring: Ring, space: Space, points: np.ndarray, frames: np.ndarray) -> None:
    """Refuses rings that the performance leaves.

    Args:
        points: [F, P, 3]; frames: [F].

    Raises:
        ChonaError: where it is left, and which radius would do.
    """
    if ring.radius <= 0.0:
        return
    away = np.linalg.norm((points - space.middle)[..., :2], axis=-1).max(axis=1)
    if away.max() + MARGIN > ring.radius:
        raise ChonaError(
            f"the character is {away.max():.2f} m from the middle of its way in frame {frames[away.argmax()]}, and the "
            f"ring's radius is {ring.radius:.2f} m; set a radius over {space.across:.2f} m, or 0 to have it fitted"
        )


@contextmanager
def ring_cameras(ring: Ring, space: Space, width: int, height: int) -> Iterator[list[Object]]:
    """The cameras as objects, which are linked to no scene; removed afterwards."""
    poses = ring_poses(ring, space, width, height)
    made: list[Object] = []
    try:
        for index, pose in enumerate(poses):
            distance = float(np.linalg.norm(pose[:3, 3] - space.middle))
            data = bpy.data.cameras.new(f"ring_{index:02d}")
            camera = bpy.data.objects.new(f"ring_{index:02d}", data)
            made.append(camera)
            data.lens, data.clip_start, data.clip_end = ring.lens, distance / 100.0, distance * 10.0
            camera.matrix_world = Matrix(pose.tolist())
        yield made
    finally:
        for camera in made:
            data = camera.data
            bpy.data.objects.remove(camera)
            bpy.data.cameras.remove(data)

"""A ring of temporary cameras around what is captured."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from bpy.types import Object
from mathutils import Vector

MARGIN = 0.2
"""Metres around the joints: flesh, hair and hands are outside of them."""


@contextmanager
def ring_cameras(
    count: int, points: np.ndarray, width: int, height: int, *, lens: float = 40.0, elevation: float = 0.25
) -> Iterator[list[Object]]:
    """Cameras at equal angles that see all ``points``, alternately level and raised; removed afterwards.

    They are linked to no scene.

    Args:
        points: [P, 3] in Blender's world, metres.
        lens: millimetres on a sensor of 36 mm.
        elevation: of every second camera, radians.
    """
    lower, upper = points.min(axis=0), points.max(axis=0)
    centre = (lower + upper) / 2.0
    radius = float(np.linalg.norm(points - centre, axis=1).max()) + MARGIN
    half_angle = np.arctan(18.0 / lens * min(width, height) / max(width, height))
    distance = radius / np.sin(half_angle)
    made: list[Object] = []
    try:
        for index in range(count):
            data = bpy.data.cameras.new(f"ring_{index:02d}")
            camera = bpy.data.objects.new(f"ring_{index:02d}", data)
            made.append(camera)
            data.lens, data.clip_start, data.clip_end = lens, distance / 100.0, distance * 10.0
            angle = 2.0 * np.pi * index / count - np.pi / 2.0  # the first looks at the face: figures face −y
            tilt = elevation * (index % 2)
            offset = Vector((np.cos(angle) * np.cos(tilt), np.sin(angle) * np.cos(tilt), np.sin(tilt))) * distance
            camera.location = Vector(centre) + offset
            camera.rotation_euler = (-offset).to_track_quat("-Z", "Y").to_euler()
        yield made
    finally:
        for camera in made:
            data = camera.data
            bpy.data.objects.remove(camera)
            bpy.data.cameras.remove(data)

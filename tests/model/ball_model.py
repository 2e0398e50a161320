"""A grid model of one object, a ball of fog so dense that it is solid: its normals are known."""

from __future__ import annotations

import numpy as np
import torch

from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.data.dataset import ObjectShape, Pose
from chona_model.field.grid import GridShape
from chona_model.grid_actor import GridActor
from chona_model.grid_model import GridModel, GridModelShape
from chona_model.skeleton import SMPL

RADIUS, CELL = 0.2, 0.01
"""Metres."""


def ball_actor() -> GridActor:
    """The model's object is called ``ball``, and its centre is its frame's origin."""
    reach = (RADIUS + 2 * CELL,) * 3
    ball = ObjectShape("ball", tuple(-side for side in reach), reach)
    field = GridShape(levels=4, coarsest=0.12, finest=0.02, rows=12)
    model = GridModel(SMPL, {}, {"ball": ball}, 0.8, GridModelShape(field=field, occupancy_cell=CELL))
    occupancy = model.occupancy
    distance = np.linalg.norm(occupancy.centres(0, np.arange(len(occupancy.densities))), axis=1)
    occupancy.densities[:] = np.where(distance < RADIUS, 400.0, 0.0)
    occupancy.support[:] = occupancy.densities > 0
    with torch.no_grad():
        model.field.density_out.weight.zero_()
        model.field.density_out.bias.fill_(6.0)
    return GridActor(model)


def ball_pose(world_from_object: np.ndarray) -> Pose:
    """The ball alone, its frame [4, 4] rigid."""
    return Pose(None, ("ball",), np.zeros((0, 4, 4)), world_from_object[None])


def normals_of_ball(camera: Camera, centre: np.ndarray) -> np.ndarray:
    """[H, W, 3] outward normals where the rays through pixels' centres enter a ball; zero where they miss it."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    origins, directions = camera.rays(np.stack([columns, rows], axis=-1) + 0.5)
    way = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    aside = origins - centre
    half = (way * aside).sum(axis=-1)
    under = half**2 - (aside**2).sum(axis=-1) + RADIUS**2
    hit = under > 0
    depth = -half - np.sqrt(np.where(hit, under, 0.0))
    return np.where(hit[..., None], (aside + depth[..., None] * way) / RADIUS, 0.0)


def looking_at(centre: np.ndarray, turn: np.ndarray, size: tuple[int, int], kind: str = "PERSP") -> Camera:
    """A camera 1.5 m from a point, with axes ``turn`` [3, 3] in the world (x right, y down, z forward)."""
    pose, (width, height) = np.eye(4), size
    pose[:3, :3], pose[:3, 3] = turn, centre - 1.5 * turn[:, 2]
    scale = 2.2 * min(size) / (1.0 if kind == ORTHOGRAPHIC else 1.0 / 1.5)
    return Camera(np.array([[scale, 0, width / 2], [0, scale, height / 2], [0, 0, 1.0]]), pose, width, height, kind)

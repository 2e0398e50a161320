"""Poses prepared for marching: posed start grids, object frames and the points that bound the figure in an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.figure import Figure
from chona_model.kernels.cpu import march as kernel
from chona_model.render.occupancy import Occupancy
from chona_model.skeleton import translation

POSED_CELL = 0.02
"""Cell of the posed start grids, metres."""

STARTS = 2
"""Canonical starts kept a posed cell: where two body parts meet, both are tried."""

APART = 0.06
"""Starts of one cell lie at least this far apart in canonical space, metres."""


@dataclass(frozen=True)
class PosedPart:
    """Occupied cells of a figure in root space.

    Attributes:
        body: [V, 3] posed centres of the person's occupied cells; centres: [V, 3] the canonical ones.
        objects: [K, 3] posed centres of the objects' occupied cells.
        starts: [cells, STARTS] int32 into the person's occupied cells; dims [3]; origin [3].
        reach: radius of a posed cell's influence, metres.
    """

    body: np.ndarray
    centres: np.ndarray
    objects: np.ndarray
    starts: np.ndarray
    dims: np.ndarray
    origin: np.ndarray
    reach: float


def slot_matrices(figure: Figure, bones: int, canonical_objects: np.ndarray) -> np.ndarray:
    """[N, 3, 4] float32: root space to each object's own frame. Exact: the inverse of a rigid matrix.

    Args:
        canonical_objects: [N, 3] canonical positions of the objects' frames.
    """
    slots = figure.transforms[bones:] @ translation(canonical_objects)
    rotation = np.swapaxes(slots[:, :3, :3], -1, -2)
    offset = -np.einsum("nij,nj->ni", rotation, slots[:, :3, 3])
    return np.concatenate([rotation, offset[..., None]], axis=-1).astype(np.float32)


def pose_cells(
    occupancy: Occupancy, person: int | None, objects: list[tuple[int, np.ndarray]], posed_body: np.ndarray | None
) -> PosedPart:
    """Builds a posed start grid.

    Args:
        person: part index of the person, or None.
        objects: (part index, [3, 4] root space to object frame) of each object present.
        posed_body: [V, 3] root-space positions of the person's occupied cells, in ``occupied`` order.
    """
    reach = 0.9 * occupancy.cell  # half a cell's diagonal, and some stretch
    moved = []
    for part, matrix in objects:
        centres = occupancy.centres(part, occupancy.occupied(part))
        moved.append((centres - matrix[:, 3]) @ matrix[:, :3])
    posed_objects = np.concatenate(moved) if moved else np.zeros((0, 3))
    if person is None or posed_body is None or len(posed_body) == 0:
        empty = np.zeros((0, 3), dtype=np.float32)
        return PosedPart(
            empty, empty, posed_objects.astype(np.float32), np.full((1, STARTS), -1, dtype=np.int32),
            np.ones(3, dtype=np.int64), np.zeros(3, dtype=np.float32), reach,
        )  # fmt: skip
    origin = (posed_body.min(axis=0) - reach - POSED_CELL).astype(np.float32)
    dims = np.ceil((posed_body.max(axis=0) + reach + POSED_CELL - origin) / POSED_CELL).astype(np.int64)
    starts = np.empty((dims.prod(), STARTS), dtype=np.int32)
    distances = np.empty((dims.prod(), STARTS), dtype=np.float32)
    centres = occupancy.centres(person, occupancy.occupied(person))
    kernel.mark_starts(
        posed_body.astype(np.float32), centres, origin, np.float32(1 / POSED_CELL), dims, np.float32(reach),
        np.float32(APART), starts, distances,
    )  # fmt: skip
    return PosedPart(
        posed_body.astype(np.float32), centres, posed_objects.astype(np.float32), starts, dims, origin, reach
    )


def depth_spans(posed: PosedPart, figure: Figure, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Near and far depth of every pixel, [H, W] float32 each; far ≤ near where the figure cannot be."""
    near = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    far = np.zeros((camera.height, camera.width), dtype=np.float32)
    camera_from_root = camera_matrix(figure, camera)
    for points in (posed.body, posed.objects):
        kernel.splat_spans(
            points, camera_from_root, camera.intrinsics, camera.kind == ORTHOGRAPHIC, posed.reach * 1.2, near, far
        )
    return near, far


def camera_matrix(figure: Figure, camera: Camera) -> np.ndarray:
    """[3, 4] root space to camera space, float64; the long way between origin and figure cancels exactly once."""
    rotation = camera.world_from_camera[:3, :3].T @ figure.root_from_world[:3, :3].T
    root_origin = -figure.root_from_world[:3, :3].T @ figure.root_from_world[:3, 3]
    offset = camera.world_from_camera[:3, :3].T @ (root_origin - camera.world_from_camera[:3, 3])
    return np.concatenate([rotation, offset[:, None]], axis=1)

"""Poses prepared for marching: posed start grids, object frames and the points that bound the figure in an image."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.figure import Figure, PoseError
from chona_model.kernels.marching import mark_starts, splat_spans
from chona_model.render.occupancy import PartCells
from chona_model.render.sides import touches_picture
from chona_model.skeleton import translation

POSED_CELL = 0.02
"""Cell of the posed start grids, metres."""

MOST_CELLS = 1 << 27
"""Of a posed start grid: a cube of 10 m, whose starts take a gigabyte."""

STARTS = 2
"""Canonical starts kept a posed cell: where two body parts meet, both are tried."""

APART = 0.06
"""Starts of one cell lie at least this far apart in canonical space, metres."""


@dataclass(frozen=True)
class PosedPart:
    """Occupied cells of a figure in root space.

    Attributes:
        outline: [S, 3] posed centres of the outermost occupied cells, of the person and of all objects.
        centres: [V, 3] canonical centres of the person's occupied cells.
        starts: [cells, chances] int32 into ``centres``; dims [3]; origin [3].
        reach: radius of a posed cell's influence, metres.
    """

    outline: np.ndarray
    centres: np.ndarray
    starts: np.ndarray
    dims: np.ndarray
    origin: np.ndarray
    reach: float


def _no_starts(chances: int) -> Any:
    return np.full((1, chances), -1, dtype=np.int32)


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
    person: PartCells | None, objects: Sequence[tuple[PartCells, np.ndarray]], posed: np.ndarray | None, cell: float,
    chances: int = STARTS,
) -> PosedPart:  # fmt: skip
    """Builds a posed start grid.

    Args:
        person: occupied cells of the person, or None; posed: [V, 3] where they are in root space, float32.
        objects: occupied cells of each object present, and [3, 4] root space to its frame.
        cell: of the occupancy, metres; chances: starts kept a posed cell, 1 or 2.

    Raises:
        PoseError: broken bones spread the person over more than ``MOST_CELLS``.
    """
    reach = 0.9 * cell  # half a cell's diagonal, and some stretch
    outline = [(thing.centres[thing.shell] - matrix[:, 3]) @ matrix[:, :3] for thing, matrix in objects]
    if person is None or posed is None or len(posed) == 0:
        centres, origin = np.zeros((0, 3), dtype=np.float32), np.zeros(3, dtype=np.float32)
        dims, starts = np.ones(3, dtype=np.int64), _no_starts(chances)
    else:
        outline.insert(0, posed[person.shell])
        centres = person.centres
        # Column by column: a reduction over [V, 3] takes twenty times as long.
        lower, upper = (np.array([of(posed[:, axis]) for axis in range(3)]) for of in (np.min, np.max))
        origin = (lower - reach - POSED_CELL).astype(np.float32)
        extent = upper + reach + POSED_CELL - origin
        if not np.prod(extent / POSED_CELL, dtype=np.float64) <= MOST_CELLS:
            size = " x ".join(f"{length:.3g}" for length in extent)
            raise PoseError(f"the pose spreads the person over {size} m; expected about its own size, check its bones")
        dims = np.ceil(extent / POSED_CELL).astype(np.int64)
        starts = mark_starts(posed, centres, origin, 1 / POSED_CELL, dims, reach, APART, chances)
    points = np.concatenate(outline) if outline else np.zeros((0, 3))
    return PosedPart(points.astype(np.float32), centres, starts, dims, origin, reach)


SPREAD = 1.2
"""An outline's cell may be stretched by the pose: its reach is taken this much larger."""


@dataclass(frozen=True)
class Window:
    """Rows ``top`` ≤ row < ``bottom`` and columns ``left`` ≤ column < ``right`` of an image."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def pixels(self) -> int:
        """Its area; 0 for an empty one."""
        return max(self.bottom - self.top, 0) * max(self.right - self.left, 0)

    def bands(self, pixels: int) -> Iterator[Window]:
        """The window cut into bands of whole rows, each of about ``pixels`` at most."""
        if self.pixels == 0:
            return
        rows = max(pixels // (self.right - self.left), 1)
        for top in range(self.top, self.bottom, rows):
            yield replace(self, top=top, bottom=min(top + rows, self.bottom))


def window_of(posed: PosedPart, figure: Figure, camera: Camera) -> Window:
    """A window outside which no pixel sees the figure: what is empty around it costs nothing."""
    whole, radius = Window(0, camera.height, 0, camera.width), posed.reach * SPREAD
    if len(posed.outline) == 0:
        return Window(0, 0, 0, 0)
    matrix = camera_matrix(figure, camera)
    points = posed.outline.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
    ahead = points[touches_picture(points, radius, camera)]
    if len(ahead) == 0:
        return Window(0, 0, 0, 0)
    flat, depth = camera.kind == ORTHOGRAPHIC, ahead[:, 2]
    if not flat and depth.min() < 2.0 * radius:
        return whole  # the camera stands in the figure, or almost
    sides = []
    for axis, size in ((1, camera.height), (0, camera.width)):
        focal, centre = camera.intrinsics[axis, axis], camera.intrinsics[axis, 2]
        low, high = ahead[:, axis] - radius, ahead[:, axis] + radius
        if not flat:  # the sphere lies in the cone of its box's nearest and farthest faces
            low = np.minimum(low / (depth - radius), low / (depth + radius))
            high = np.maximum(high / (depth - radius), high / (depth + radius))
        # A pixel more on every side, as spans have it.
        first, last = np.floor(focal * low.min() + centre) - 1, np.ceil(focal * high.max() + centre) + 1
        sides += [int(np.clip(first, 0, size)), int(np.clip(last, 0, size))]
    return Window(*sides)


def _as_it_is(array: np.ndarray) -> np.ndarray:
    return array


def depth_spans(
    posed: PosedPart, figure: Figure, camera: Camera, window: Window | None = None,
    real: Callable[[np.ndarray], Any] = _as_it_is,
) -> tuple[Any, Any]:  # fmt: skip
    """Near and far depth of every pixel of a window (by default the image), [H, W] float32 each.

    far ≤ near where the figure cannot be.

    Args:
        real: makes the arrays those of a model on another device (``GridModel.real``).
    """
    window = window or Window(0, camera.height, 0, camera.width)
    size = (max(window.bottom - window.top, 0), max(window.right - window.left, 0))
    near, far = real(np.full(size, np.inf, dtype=np.float32)), real(np.zeros(size, dtype=np.float32))
    intrinsics, matrix, reach = camera.intrinsics.copy(), camera_matrix(figure, camera), posed.reach * SPREAD
    intrinsics[:2, 2] -= window.left, window.top
    # Cells beside the camera would be splatted over every pixel, as those around it are.
    touching = touches_picture(posed.outline.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3], reach, camera)
    splat_spans(
        real(posed.outline[touching]), real(matrix), real(intrinsics), camera.kind == ORTHOGRAPHIC, reach, near, far
    )
    return near, far


def camera_matrix(figure: Figure, camera: Camera) -> np.ndarray:
    """[3, 4] root space to camera space, float64; the long way between origin and figure cancels exactly once."""
    rotation = camera.world_from_camera[:3, :3].T @ figure.root_from_world[:3, :3].T
    root_origin = -figure.root_from_world[:3, :3].T @ figure.root_from_world[:3, 3]
    offset = camera.world_from_camera[:3, :3].T @ (root_origin - camera.world_from_camera[:3, 3])
    return np.concatenate([rotation, offset[:, None]], axis=1)

"""Shapes from signed distances: round cones and ellipsoids, smooth unions, and a mesh of quads (surface nets).

Plain numpy, metres, any axes.  Distances of flattened shapes are only bounds; the level set itself is right, which is
all that a mesh needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FAR = 1.0
"""Distance given where no shape reaches, metres."""


@dataclass(frozen=True)
class RoundCone:
    """Two spheres and everything between them.

    Attributes:
        start, end: [3] centres, metres.
        start_radius, end_radius: metres.
        stretch: [3] the cone is stretched along the axes by these factors about its start.
        blend: how softly it joins what was there before, metres; 0 gives a crease.
    """

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    start_radius: float
    end_radius: float
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blend: float = 0.02

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of an axis-parallel box around the shape."""
        reach = max(self.start_radius, self.end_radius) * np.array(self.stretch)
        ends = np.array([self.start, self.end])
        return ends.min(axis=0) - reach, ends.max(axis=0) + reach

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distances [...] of points [..., 3]; negative inside."""
        stretch = np.array(self.stretch)
        local = (points - np.array(self.start)) / stretch
        axis = (np.array(self.end) - np.array(self.start)) / stretch
        length = np.dot(axis, axis)
        along = np.clip(local @ axis / length, 0.0, 1.0) if length > 1e-12 else np.zeros(local.shape[:-1])
        radius = self.start_radius + along * (self.end_radius - self.start_radius)
        return (np.linalg.norm(local - along[..., None] * axis, axis=-1) - radius) * stretch.min()


def ellipsoid(centre: Sequence[float], radii: Sequence[float], blend: float = 0.02) -> RoundCone:
    """An ellipsoid with the given half axes, metres."""
    x, y, z = centre
    return RoundCone((x, y, z), (x, y, z), 1.0, 1.0, (radii[0], radii[1], radii[2]), blend)


def smooth_minimum(first: np.ndarray, second: np.ndarray, blend: float) -> np.ndarray:
    """The union of two distance fields, rounded where they meet within ``blend`` metres."""
    if blend <= 0.0:
        return np.minimum(first, second)
    overlap = np.maximum(blend - np.abs(first - second), 0.0) / blend
    return np.minimum(first, second) - overlap * overlap * blend * 0.25


@dataclass(frozen=True)
class Grid:
    """A regular lattice of points.

    Attributes:
        origin: [3] first point, metres.
        step: distance of neighbours, metres.
        shape: points along x, y and z.
    """

    origin: np.ndarray
    step: float
    shape: tuple[int, int, int]

    def points(self, low: Sequence[int], high: Sequence[int]) -> np.ndarray:
        """[..., 3] positions of the block low ≤ index < high."""
        axes = [self.origin[a] + self.step * np.arange(low[a], high[a]) for a in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def grid_around(lower: Sequence[float], upper: Sequence[float], step: float) -> Grid:
    """The lattice that covers a box."""
    low, high = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    counts = np.ceil((high - low) / step).astype(int) + 1
    return Grid(low, step, (int(counts[0]), int(counts[1]), int(counts[2])))


def union(grid: Grid, shapes: Sequence[RoundCone]) -> np.ndarray:
    """Distances on the grid of the smooth union of shapes, each evaluated only where it matters."""
    field = np.full(grid.shape, FAR)
    for shape in shapes:
        lower, upper = shape.box()
        margin = shape.blend + 6 * grid.step
        low = np.clip(np.floor((lower - margin - grid.origin) / grid.step).astype(int), 0, grid.shape)
        high = np.clip(np.ceil((upper + margin - grid.origin) / grid.step).astype(int) + 1, 0, grid.shape)
        if (high <= low).any():
            continue
        block = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        field[block] = smooth_minimum(field[block], shape.distance(grid.points(low, high)), shape.blend)
    return field


def sample(grid: Grid, field: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Trilinear values [N] of a field at points [N, 3]."""
    position = np.clip((points - grid.origin) / grid.step, 0.0, np.array(grid.shape) - 1.000001)
    base = position.astype(int)
    share = position - base
    value = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, share, 1.0 - share), axis=-1)
        index = base + np.array(corner)
        value += weight * field[index[:, 0], index[:, 1], index[:, 2]]
    return value


def surface_nets(grid: Grid, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The zero level as quads, one vertex in each cell that it crosses.

    Returns:
        vertices [V, 3] metres and quads [F, 4], counter-clockwise seen from outside.
    """
    inside = field < 0.0
    corners = [inside[i : i - 1 or None, j : j - 1 or None, k : k - 1 or None] for i, j, k in np.ndindex(2, 2, 2)]
    count = np.sum(corners, axis=0)
    cells = np.argwhere((count > 0) & (count < 8))
    number = np.full(count.shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    total, hits = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for axis in range(3):
        step = np.eye(3, dtype=int)[axis]
        for offset in (o for o in np.ndindex(2, 2, 2) if o[axis] == 0):
            start = cells + np.array(offset)
            a, b = field[tuple(start.T)], field[tuple((start + step).T)]
            crossed = (a < 0) != (b < 0)
            along = np.where(crossed, a / np.where(crossed, a - b, 1.0), 0.0)
            total += np.where(crossed[:, None], start + along[:, None] * step, 0.0)
            hits += crossed
    vertices = _on_surface(grid, field, grid.origin + grid.step * total / hits[:, None])
    return vertices, _quads(inside, number)


def _quads(inside: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Quads around every lattice edge whose ends lie on different sides."""
    quads = []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        a, b = np.moveaxis(inside, axis, 0)[:-1], np.moveaxis(inside, axis, 0)[1:]
        for leaving in (True, False):
            edges = np.argwhere(a & ~b if leaving else ~a & b)
            # argwhere counts along the moved axes: put them back in x, y, z order.
            order = [axis] + [k for k in range(3) if k != axis]
            edges = edges[:, np.argsort(order)]
            loop = [edges - u - v, edges - v, edges, edges - u]
            quad = np.stack([number[tuple(cell.T)] for cell in loop], axis=-1)
            quads.append(quad if leaving else quad[:, ::-1])
    return np.concatenate(quads)


def _on_surface(grid: Grid, field: np.ndarray, vertices: np.ndarray, rounds: int = 3) -> np.ndarray:
    """Newton steps along the gradient: removes the stairs that averaging in cells leaves."""
    limit = 0.5 * grid.step
    for _ in range(rounds):
        value = sample(grid, field, vertices)
        gradient = (
            np.stack(
                [
                    sample(grid, field, vertices + d) - sample(grid, field, vertices - d)
                    for d in np.eye(3) * 0.5 * grid.step
                ],
                axis=-1,
            )
            / grid.step
        )
        length = np.maximum(np.sum(gradient * gradient, axis=-1), 0.05)
        vertices = vertices - np.clip((value / length)[:, None] * gradient, -limit, limit)
    return vertices

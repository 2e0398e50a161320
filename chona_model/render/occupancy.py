"""Occupancy of every part (person or object) in its own frame: cells with a cached density, 0 where nothing is.

Starts as the masks' visual hull, so empty space never costs anything; later follows the field's density.  All
connected components are kept: an object that does not touch the hand is as real as the hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np


@dataclass
class Occupancy:
    """Occupancy grids of I parts, concatenated.

    Attributes:
        cell: metres.
        origins: [I, 3] float32 lower corners in each part's frame; dims: [I, 3] int64 cells (x fastest).
        first: [I + 1] int64 begin of each part's cells.
        densities: [cells] float32, 1/m; 0 = empty.
        support: [cells] bool, the visual hull: outside it the field was never trained.
    """

    cell: float
    origins: np.ndarray
    dims: np.ndarray
    first: np.ndarray
    densities: np.ndarray
    support: np.ndarray

    def centres(self, part: int, cells: np.ndarray) -> np.ndarray:
        """[K, 3] float32 centres of a part's cells, given by index within the part."""
        nx, ny, _ = self.dims[part]
        index = np.stack([cells % nx, cells // nx % ny, cells // (nx * ny)], axis=-1)
        return (self.origins[part] + self.cell * (index + 0.5)).astype(np.float32)

    def part(self, part: int) -> np.ndarray:
        """View of one part's densities."""
        return self.densities[self.first[part] : self.first[part + 1]]

    def occupied(self, part: int) -> np.ndarray:
        """Indices, within the part, of its occupied cells."""
        return np.flatnonzero(self.part(part) > 0)


def make_occupancy(lower: np.ndarray, upper: np.ndarray, cell: float) -> Occupancy:
    """Empty grids over boxes ``lower``, ``upper`` [I, 3], metres."""
    dims = np.maximum(np.ceil((upper - lower) / cell).astype(np.int64), 1)
    first = np.concatenate([[0], np.cumsum(dims.prod(axis=1))])
    return Occupancy(
        cell,
        lower.astype(np.float32),
        dims,
        first,
        np.zeros(first[-1], dtype=np.float32),
        np.zeros(first[-1], dtype=bool),
    )


@dataclass(frozen=True)
class PartCells:
    """A part's occupied cells at one time.

    Attributes:
        centres: [V, 3] float32 in the part's own frame, metres.
        shell: [S] int64 which of them have an empty neighbour: all that bounds the part in an image.
        cell: edge of a cell, metres.
    """

    centres: np.ndarray
    shell: np.ndarray
    cell: float


def part_cells(occupancy: Occupancy, part: int) -> PartCells:
    """The occupied cells of a part as they are now."""
    nx, ny, nz = occupancy.dims[part]
    occupied = occupancy.part(part).reshape(nz, ny, nx) > 0
    padded = np.pad(occupied, 1)
    inner = occupied.copy()
    for axis in range(3):
        for side in (0, 2):
            shift = [slice(1, -1)] * 3
            shift[axis] = slice(side, side + occupied.shape[axis])
            inner &= padded[tuple(shift)]
    index = np.flatnonzero(occupied)
    return PartCells(occupancy.centres(part, index), np.flatnonzero(~inner.reshape(-1)[index]), occupancy.cell)


UNKNOWN_DENSITY = 0.5
"""Cached density of cells nothing is known of yet, 1/m: worth sampling, hides nothing."""

CULL_DENSITY = 2.5
"""Cells whose density stays below this are empty: 1 cm of it hides 2.5 % of what is behind, 1/m."""

CULL_SHARE = 0.1
"""… but only cells under this share of their part's greatest density: a field that has not formed yet stays whole."""

FADE = 0.7
"""What is left of a cell's cached density at every update, unless the field renews it."""


def whole_support(occupancy: Occupancy) -> Occupancy:
    """The same grids with every cell of the hull sampled and none believed opaque: nothing is skipped by density."""
    densities = np.where(occupancy.support, np.float32(UNKNOWN_DENSITY), np.float32(0.0))
    return Occupancy(occupancy.cell, occupancy.origins, occupancy.dims, occupancy.first, densities, occupancy.support)


def without_thin(occupancy: Occupancy, threshold: float) -> Occupancy:
    """The same grids without cells whose cached density is at most ``threshold``, 1/m."""
    if threshold == 0.0:
        return occupancy
    densities = np.where(occupancy.densities > threshold, occupancy.densities, np.float32(0.0))
    return replace(occupancy, densities=densities)


def make_coarser(occupancy: Occupancy, factor: int) -> Occupancy:
    """Grids of larger cells, ``factor`` of the given ones along each axis: a block is as dense as its densest cell."""
    if factor == 1:
        return occupancy
    dims = -(-occupancy.dims // factor)
    return Occupancy(
        occupancy.cell * factor, occupancy.origins, dims, np.concatenate([[0], np.cumsum(dims.prod(axis=1))]),
        coarser_cells(occupancy.densities, occupancy, factor, np.maximum.reduce),
        coarser_cells(occupancy.support, occupancy, factor, np.logical_or.reduce),
    )  # fmt: skip


def coarser_cells(
    values: np.ndarray, occupancy: Occupancy, factor: int, take: Callable[..., np.ndarray] = np.mean
) -> np.ndarray:
    """Values [cells, ...] of the given grids as those of ``make_coarser``'s: ``take`` of every block of cells."""
    if factor == 1:
        return values
    parts = []
    for part, (nx, ny, nz) in enumerate(occupancy.dims):
        own = values[occupancy.first[part] : occupancy.first[part + 1]].reshape(nz, ny, nx, -1)
        padding = [(0, -size % factor) for size in (nz, ny, nx)]
        padded = np.pad(own, [*padding, (0, 0)])
        blocks = padded.reshape(
            padded.shape[0] // factor, factor, padded.shape[1] // factor, factor, padded.shape[2] // factor, factor, -1
        )
        parts.append(take(blocks, axis=(1, 3, 5)).reshape(-1, *values.shape[1:]))
    return np.ascontiguousarray(np.concatenate(parts).astype(values.dtype))

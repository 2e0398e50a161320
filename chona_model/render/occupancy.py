"""Occupancy of every part (person or object) in its own frame: cells with a cached density, 0 where nothing is.

Starts as the masks' visual hull, so empty space never costs anything; later follows the field's density.  All
connected components are kept: an object that does not touch the hand is as real as the hand.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    centres: np.ndarray
    shell: np.ndarray


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
    return PartCells(occupancy.centres(part, index), np.flatnonzero(~inner.reshape(-1)[index]))


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

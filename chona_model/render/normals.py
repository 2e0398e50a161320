"""Which way the surfaces of a part face, from its occupancy."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from chona_model.render.occupancy import Occupancy

SMOOTHING = 1.5
"""Cells over which normals are smoothed: they are to say how a limb is turned, not how cells are stacked."""


def surface_normals(occupancy: Occupancy) -> np.ndarray:
    """[cells, 3] float32 outward directions of every part's surface, in its own frame; zero far from any.

    They come from the occupied cells with their cavities filled, smoothed, so they are of any length.
    """
    normals = np.zeros((occupancy.first[-1], 3), dtype=np.float32)
    for part in range(len(occupancy.dims)):
        nx, ny, nz = occupancy.dims[part]
        solid = occupancy.part(part).reshape(nz, ny, nx) > 0
        box = _around(solid)
        if box is None:
            continue
        smooth = ndimage.gaussian_filter(ndimage.binary_fill_holes(solid[box]).astype(np.float32), SMOOTHING)
        own = normals[occupancy.first[part] : occupancy.first[part + 1]].reshape(nz, ny, nx, 3)[box]
        for axis, name in ((2, 0), (1, 1), (0, 2)):  # cells are stored x fastest
            own[..., name] = -np.gradient(smooth, axis=axis)
    return normals


def _around(solid: np.ndarray) -> tuple[slice, ...] | None:
    """The cells that hold anything, and the smoothing's reach around them."""
    reach, slices = round(3 * SMOOTHING), []
    for axis in range(3):
        present = np.flatnonzero(solid.any(axis=tuple(other for other in range(3) if other != axis)))
        if len(present) == 0:
            return None
        begin, end = max(present[0] - reach, 0), min(present[-1] + 1 + reach, solid.shape[axis])
        slices.append(slice(min(begin, solid.shape[axis] - 2), max(end, 2)))
    return tuple(slices)

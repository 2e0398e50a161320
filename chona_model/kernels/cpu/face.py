"""Which way what rays met faces in its pose."""

from __future__ import annotations

import numpy as np

from chona_model.kernels.cpu.jit import entry
from chona_model.kernels.cpu.light import normal_at, unit
from chona_model.kernels.cpu.newton import WORK, carry_normal


@entry
def face(chosen, found, volume, parts, normals):
    """Normals of candidates, root space: of length one, or zero where a part's cells show no surface near.

    Unlike ``Candidates.normal``, which the light was learned with, they go through the whole warp.

    Args:
        chosen: [M] int64 candidates; found: ``Candidates`` whose ``pair`` is 1 + the slot of those on objects.
        volume, parts: of the pose.
        normals: [M, 3] float32, written.
    """
    work, matrix = np.empty(WORK, np.float32), parts.slot_matrix
    for row in range(len(chosen)):
        m = chosen[row]
        x, y, z = found.point[m, 0], found.point[m, 1], found.point[m, 2]
        a, b, c = normal_at(x, y, z, found.part[m], parts)
        if found.thing[m]:
            s = found.pair[m] - 1
            a, b, c = (
                matrix[s, 0, 0] * a + matrix[s, 1, 0] * b + matrix[s, 2, 0] * c,
                matrix[s, 0, 1] * a + matrix[s, 1, 1] * b + matrix[s, 2, 1] * c,
                matrix[s, 0, 2] * a + matrix[s, 1, 2] * b + matrix[s, 2, 2] * c,
            )
        else:
            a, b, c = carry_normal(x, y, z, a, b, c, volume, work)
        normals[row, 0], normals[row, 1], normals[row, 2] = unit(a, b, c)

"""One root of the voxel volume's f(x) = A(x) [x; 1] by Newton, with the closed-form Jacobian sixteen lanes wide.

A node's 3×4 matrix, padded to sixteen floats, is one vector and one cache line: A(x) and its three derivatives along
the grid's axes are eight fused products each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chona_model.kernels.cpu.jit import corner_of, inlined, inner, within
from chona_model.kernels.cpu.simd import LANES, fma, load, splat, store

SMALLEST_DETERMINANT = np.float32(0.05)
"""Blended rotations have determinants near 1; below this a step would leave the neighbourhood of the start."""

WORK = 4 * LANES
"""Floats that ``find_root`` works in."""


class Volume(NamedTuple):
    """Blended matrices of one pose on a canonical grid of nodes (see ``deform.voxels``).

    Attributes:
        matrices: [M, 16] float32, rows of 3×4 matrices padded to a cache line.
        nodes: [corners] int32 rows of the grid's corners, x fastest.
        dims: [3] int64 corners; origin: [3] float32 metres; inverse_cell: 1/m.
    """

    matrices: np.ndarray
    nodes: np.ndarray
    dims: np.ndarray
    origin: np.ndarray
    inverse_cell: np.float32


class RootLimits(NamedTuple):
    """Newton steps at most; residual that ends the search, longest step and residual still accepted, metres."""

    steps: int
    tolerance: np.float32
    longest: np.float32
    accept: np.float32


@inlined
def _blend(x, y, z, volume, work):
    """A(x) and ∂A/∂x, ∂A/∂y, ∂A/∂z, sixteen floats each, to ``work``."""
    one, edge, zero = np.float32(1.0), np.float32(1e-3), np.float32(0.0)
    cell, nx, ny = volume.inverse_cell, volume.dims[0], volume.dims[1]
    px = within((x - volume.origin[0]) * cell, np.float32(nx - 1) - edge)
    py = within((y - volume.origin[1]) * cell, np.float32(ny - 1) - edge)
    pz = within((z - volume.origin[2]) * cell, np.float32(volume.dims[2] - 1) - edge)
    ix, iy, iz = corner_of(px, nx), corner_of(py, ny), corner_of(pz, volume.dims[2])
    u, v, w = px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz)
    total = splat(zero)
    along_x, along_y, along_z = total, total, total
    for corner in range(8):
        dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
        wx, wy, wz = (u if dx else one - u), (v if dy else one - v), (w if dz else one - w)
        row = load(volume.matrices, LANES * np.int64(volume.nodes[ix + dx + nx * (iy + dy + ny * (iz + dz))]))
        total = fma(splat(wx * wy * wz), row, total)
        along_x = fma(splat((cell if dx else -cell) * wy * wz), row, along_x)
        along_y = fma(splat((cell if dy else -cell) * wx * wz), row, along_y)
        along_z = fma(splat((cell if dz else -cell) * wx * wy), row, along_z)
    store(work, 0, total)
    store(work, LANES, along_x)
    store(work, 2 * LANES, along_y)
    store(work, 3 * LANES, along_z)


@inlined
def _times(work, begin, x, y, z):
    """Row of a blended matrix times [x; 1]."""
    return work[begin] * x + work[begin + 1] * y + work[begin + 2] * z + work[begin + 3]


@inlined
def _jacobian(work, x, y, z):
    """J of f at the point that ``work`` was blended at, row by row."""
    return (
        work[0] + _times(work, 16, x, y, z), work[1] + _times(work, 32, x, y, z), work[2] + _times(work, 48, x, y, z),
        work[4] + _times(work, 20, x, y, z), work[5] + _times(work, 36, x, y, z), work[6] + _times(work, 52, x, y, z),
        work[8] + _times(work, 24, x, y, z), work[9] + _times(work, 40, x, y, z), work[10] + _times(work, 56, x, y, z),
    )  # fmt: skip


@inlined
def carry_normal(x, y, z, nx, ny, nz, volume, work):
    """A surface's normal where f takes it, of any length, from the canonical point (x, y, z) and normal there.

    It goes with the cofactors of J, det J · J⁻ᵀ: planes stay planes, which J itself does not keep upright.

    Args:
        work: [WORK] float32.
    """
    _blend(x, y, z, volume, work)
    a, b, c, d, e, f, g, h, i = _jacobian(work, x, y, z)
    return (
        (e * i - f * h) * nx + (f * g - d * i) * ny + (d * h - e * g) * nz,
        (c * h - b * i) * nx + (a * i - c * g) * ny + (b * g - a * h) * nz,
        (b * f - c * e) * nx + (c * d - a * f) * ny + (a * e - b * d) * nz,
    )


@inlined
def solve_jacobian(work, x, y, z, r0, r1, r2):
    """J⁻¹ r at the point that ``work`` was blended at."""
    a, b, c, d, e, f, g, h, i = _jacobian(work, x, y, z)
    c00, c01, c02 = e * i - f * h, c * h - b * i, b * f - c * e
    c10, c11, c12 = f * g - d * i, a * i - c * g, c * d - a * f
    c20, c21, c22 = d * h - e * g, b * g - a * h, a * e - b * d
    determinant = a * c00 + b * c10 + c * c20
    if abs(determinant) < SMALLEST_DETERMINANT:
        determinant = SMALLEST_DETERMINANT if determinant >= 0 else -SMALLEST_DETERMINANT
    inverse = np.float32(1.0) / determinant
    return (
        (c00 * r0 + c01 * r1 + c02 * r2) * inverse,
        (c10 * r0 + c11 * r1 + c12 * r2) * inverse,
        (c20 * r0 + c21 * r1 + c22 * r2) * inverse,
    )


@inner
def find_root(px, py, pz, x, y, z, volume, limits, work):
    """Newton from (x, y, z) to the canonical point that f takes to the posed (px, py, pz); keeps the best iterate.

    Args:
        work: [WORK] float32; afterwards blended at the last iterate.

    Returns:
        The point and its residual, metres.
    """
    bx, by, bz, best = x, y, z, np.float32(1e30)
    for step in range(limits.steps + 1):
        _blend(x, y, z, volume, work)
        r0 = _times(work, 0, x, y, z) - px
        r1 = _times(work, 4, x, y, z) - py
        r2 = _times(work, 8, x, y, z) - pz
        residual = np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
        if residual < best:
            bx, by, bz, best = x, y, z, residual
        if residual < limits.tolerance or step == limits.steps:
            break
        s0, s1, s2 = solve_jacobian(work, x, y, z, r0, r1, r2)
        length = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
        if length > limits.longest:
            shrink = limits.longest / length
            s0, s1, s2 = s0 * shrink, s1 * shrink, s2 * shrink
        x, y, z = x - s0, y - s1, z - s2
    return bx, by, bz, best

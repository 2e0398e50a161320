"""Multi-resolution grid encoding (instant-NGP's), forward and backward.

One level after the other: its table fits a core's cache, and gradients are scattered by one thread a level, which needs
no atomics, so results are the same in every run.  A row's four features are one vector.
"""

from __future__ import annotations

import numpy as np

from chona_model.kernels.cpu.jit import corner_of, entry, inlined, inner, within
from chona_model.kernels.cpu.simd import fma, load4, splat4, store

FEATURES = 4
"""Features a level: one short vector."""

PRIME_Y = np.uint32(2654435761)
PRIME_Z = np.uint32(805459861)


@inlined
def corner_rows(ix, iy, iz, nx, ny, dense, mask):
    """Rows of a cell's eight corners, x fastest: plain indices where the level is dense, else the spatial hash."""
    if dense:
        base, sheet = ix + nx * (iy + ny * iz), nx * ny
        return (
            base, base + 1, base + nx, base + nx + 1,
            base + sheet, base + sheet + 1, base + sheet + nx, base + sheet + nx + 1,
        )  # fmt: skip
    x0, x1 = np.uint32(ix), np.uint32(ix + 1)
    y0 = np.uint32(iy) * PRIME_Y
    z0 = np.uint32(iz) * PRIME_Z
    y1, z1 = y0 + PRIME_Y, z0 + PRIME_Z
    a, b, c, d = y0 ^ z0, y1 ^ z0, y0 ^ z1, y1 ^ z1
    return (
        np.int32((x0 ^ a) & mask), np.int32((x1 ^ a) & mask), np.int32((x0 ^ b) & mask), np.int32((x1 ^ b) & mask),
        np.int32((x0 ^ c) & mask), np.int32((x1 ^ c) & mask), np.int32((x0 ^ d) & mask), np.int32((x1 ^ d) & mask),
    )  # fmt: skip


@inlined
def corner_weights(fx, fy, fz):
    """Trilinear weights of a cell's eight corners, x fastest."""
    one = np.float32(1.0)
    gx, gy, gz = one - fx, one - fy, one - fz
    a, b, c, d = gy * gz, fy * gz, gy * fz, fy * fz
    return gx * a, fx * a, gx * b, fx * b, gx * c, fx * c, gx * d, fx * d


@inlined
def _corners(points, m, lower, which, scale, nx, ny, nz, dense, mask):
    """Rows and weights of the corners around point ``m``, which lies in the part ``which``."""
    px = within((points[m, 0] - lower[which, 0]) * scale, np.float32(nx - 1))
    py = within((points[m, 1] - lower[which, 1]) * scale, np.float32(ny - 1))
    pz = within((points[m, 2] - lower[which, 2]) * scale, np.float32(nz - 1))
    ix, iy, iz = corner_of(px, nx), corner_of(py, ny), corner_of(pz, nz)
    rows = corner_rows(ix, iy, iz, nx, ny, dense, mask)
    return rows, corner_weights(px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz))


@inner
def encode_level(level, points, part, begin, end, of, lower, table, inverse_cells, dims, dense, rows_per_level, out):
    """One level of ``encode`` of the points ``begin`` to ``end``; ``of`` [parts] int32: whose tables a part reads."""
    mask = np.uint32(rows_per_level - 1)
    scale, is_dense, levels = inverse_cells[level], dense[level], table.shape[1]
    nx, ny, nz = np.int32(dims[level, 0]), np.int32(dims[level, 1]), np.int32(dims[level, 2])
    for m in range(begin, end):
        which = of[part[m]]
        r, w = _corners(points, m, lower, which, scale, nx, ny, nz, is_dense, mask)
        base = (which * levels + level) * rows_per_level
        one = splat4(w[0]) * load4(table, FEATURES * (base + r[0]))
        two = splat4(w[1]) * load4(table, FEATURES * (base + r[1]))
        one = fma(splat4(w[2]), load4(table, FEATURES * (base + r[2])), one)
        two = fma(splat4(w[3]), load4(table, FEATURES * (base + r[3])), two)
        one = fma(splat4(w[4]), load4(table, FEATURES * (base + r[4])), one)
        two = fma(splat4(w[5]), load4(table, FEATURES * (base + r[5])), two)
        one = fma(splat4(w[6]), load4(table, FEATURES * (base + r[6])), one)
        two = fma(splat4(w[7]), load4(table, FEATURES * (base + r[7])), two)
        store(out, FEATURES * (m * levels + level), one + two)


@entry
def encode(level, points, identity, lower, table, inverse_cells, dims, dense, rows_per_level, out):
    """Interpolated features of one level.

    Args:
        points: [M, 3] in the identity's frame, metres; outside the grid counts as on its border, NaN gives NaN.
        identity: [M] int32 index of the identity whose tables to read; lower: [I, 3] lower corners.
        table: [I, L, T, FEATURES].
        inverse_cells: [L] 1 / cell size, 1/m.
        dims: [L, 3] int64 corners along each axis (dense levels).
        dense: [L] bool.
        rows_per_level: T, a power of two.
        out: [M, L · FEATURES], the level's columns written.
    """
    own = np.arange(len(lower), dtype=np.int32)
    encode_level(
        level, points, identity, 0, len(points), own, lower, table, inverse_cells, dims, dense, rows_per_level, out
    )


@entry
def encode_backward_table(
    level, points, identity, lower, grad_out, inverse_cells, dims, dense, rows_per_level, grad_table, touched
):  # fmt: skip
    """Adds one level's gradients to ``grad_table`` [I, L, T, FEATURES]; arguments as in ``encode``.

    Args:
        touched: [I · L · T] uint8, set to 1 for every row that was added to.
    """
    mask = np.uint32(rows_per_level - 1)
    scale, is_dense, levels = inverse_cells[level], dense[level], grad_table.shape[1]
    nx, ny, nz = np.int32(dims[level, 0]), np.int32(dims[level, 1]), np.int32(dims[level, 2])
    for m in range(len(points)):
        which = identity[m]
        r, w = _corners(points, m, lower, which, scale, nx, ny, nz, is_dense, mask)
        base = (which * levels + level) * rows_per_level
        grad = load4(grad_out, FEATURES * (m * levels + level))
        _add_corner(grad_table, touched, base + r[0], w[0], grad)
        _add_corner(grad_table, touched, base + r[1], w[1], grad)
        _add_corner(grad_table, touched, base + r[2], w[2], grad)
        _add_corner(grad_table, touched, base + r[3], w[3], grad)
        _add_corner(grad_table, touched, base + r[4], w[4], grad)
        _add_corner(grad_table, touched, base + r[5], w[5], grad)
        _add_corner(grad_table, touched, base + r[6], w[6], grad)
        _add_corner(grad_table, touched, base + r[7], w[7], grad)


@inlined
def _add_corner(grad_table, touched, row, weight, grad):
    touched[row] = 1
    store(grad_table, FEATURES * row, fma(splat4(weight), grad, load4(grad_table, FEATURES * row)))


@entry
def encode_backward_points(
    begin, end, points, identity, lower, table, grad_out, inverse_cells, dims, dense, rows_per_level, grad_points
):  # fmt: skip
    """Gradient of the encoding with respect to the points ``begin`` to ``end``, written to ``grad_points`` [M, 3]."""
    mask = np.uint32(rows_per_level - 1)
    levels = table.shape[1]
    one, zero = np.float32(1.0), np.float32(0.0)
    for m in range(begin, end):
        gx = gy = gz = zero
        which = identity[m]
        x, y, z = points[m, 0] - lower[which, 0], points[m, 1] - lower[which, 1], points[m, 2] - lower[which, 2]
        for level in range(levels):
            scale, is_dense = inverse_cells[level], dense[level]
            nx, ny, nz = np.int32(dims[level, 0]), np.int32(dims[level, 1]), np.int32(dims[level, 2])
            px, py, pz = (
                within(x * scale, np.float32(nx - 1)), within(y * scale, np.float32(ny - 1)),
                within(z * scale, np.float32(nz - 1)),
            )  # fmt: skip
            ix, iy, iz = corner_of(px, nx), corner_of(py, ny), corner_of(pz, nz)
            # Outside the grid the encoding is that of its border: constant along the axis.
            inside_x, inside_y, inside_z = px == x * scale, py == y * scale, pz == z * scale
            fx, fy, fz = px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz)
            rows = corner_rows(ix, iy, iz, nx, ny, is_dense, mask)
            column = level * FEATURES
            for corner in range(8):
                dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
                wx = fx if dx else one - fx
                wy = fy if dy else one - fy
                wz = fz if dz else one - fz
                row = rows[corner]
                value = (
                    table[which, level, row, 0] * grad_out[m, column]
                    + table[which, level, row, 1] * grad_out[m, column + 1]
                    + table[which, level, row, 2] * grad_out[m, column + 2]
                    + table[which, level, row, 3] * grad_out[m, column + 3]
                ) * scale
                if inside_x:
                    gx += value * wy * wz * (one if dx else -one)
                if inside_y:
                    gy += value * wx * wz * (one if dy else -one)
                if inside_z:
                    gz += value * wx * wy * (one if dz else -one)
        grad_points[m, 0] = gx
        grad_points[m, 1] = gy
        grad_points[m, 2] = gz

"""Multi-resolution grid encoding (instant-NGP's), forward and backward.

Levels are the outer, parallel loop: one level's table fits a core's cache, and scattering gradients level by level
needs no atomics, so results are the same in every run.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

FEATURES = 4
"""Features a level; a constant so that the inner loops unroll into one vector instruction."""

PRIME_Y = np.uint32(2654435761)
PRIME_Z = np.uint32(805459861)


@njit(inline="always")
def corner_row(ix, iy, iz, nx, ny, dense, mask):
    """Row of a grid corner inside its level: plain index where the level is dense, else the spatial hash."""
    if dense:
        return ix + nx * (iy + ny * iz)
    hashed = np.uint32(ix) ^ (np.uint32(iy) * PRIME_Y) ^ (np.uint32(iz) * PRIME_Z)
    return np.int64(hashed & mask)


@njit(inline="always", fastmath=True)
def corner_rows(ix, iy, iz, nx, ny, dense, mask):
    """Rows of a cell's eight corners, x fastest."""
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
    return (
        np.int32((x0 ^ y0 ^ z0) & mask), np.int32((x1 ^ y0 ^ z0) & mask),
        np.int32((x0 ^ y1 ^ z0) & mask), np.int32((x1 ^ y1 ^ z0) & mask),
        np.int32((x0 ^ y0 ^ z1) & mask), np.int32((x1 ^ y0 ^ z1) & mask),
        np.int32((x0 ^ y1 ^ z1) & mask), np.int32((x1 ^ y1 ^ z1) & mask),
    )  # fmt: skip


@njit(inline="always", fastmath=True)
def corner_weights(fx, fy, fz):
    """Trilinear weights of a cell's eight corners, x fastest."""
    one = np.float32(1.0)
    gx, gy, gz = one - fx, one - fy, one - fz
    return (
        gx * gy * gz, fx * gy * gz, gx * fy * gz, fx * fy * gz,
        gx * gy * fz, fx * gy * fz, gx * fy * fz, fx * fy * fz,
    )  # fmt: skip


@njit(parallel=True, fastmath=True, cache=True)
def encode(points, identity, table, inverse_cells, dims, dense, rows_per_level, out):
    """Interpolated features of every level.

    Args:
        points: [M, 3] metres from the identity's lower corner, ≥ 0.
        identity: [M] int32 index of the identity whose tables to read.
        table: [I, L, T, FEATURES].
        inverse_cells: [L] 1 / cell size, 1/m.
        dims: [L, 3] int64 corners along each axis (dense levels).
        dense: [L] bool.
        rows_per_level: T, a power of two.
        out: [M, L · FEATURES], written.
    """
    mask = np.uint32(rows_per_level - 1)
    for level in prange(table.shape[1]):
        scale, is_dense = inverse_cells[level], dense[level]
        nx, ny, nz = np.int32(dims[level, 0]), np.int32(dims[level, 1]), np.int32(dims[level, 2])
        column = level * FEATURES
        for m in range(len(points)):
            px, py, pz = points[m, 0] * scale, points[m, 1] * scale, points[m, 2] * scale
            ix, iy, iz = np.int32(px), np.int32(py), np.int32(pz)
            if is_dense:
                ix, iy, iz = min(ix, nx - 2), min(iy, ny - 2), min(iz, nz - 2)
            rows = corner_rows(ix, iy, iz, nx, ny, is_dense, mask)
            weights = corner_weights(px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz))
            which = identity[m]
            a0 = a1 = a2 = a3 = np.float32(0.0)
            for corner in range(8):
                row, weight = rows[corner], weights[corner]
                a0 += weight * table[which, level, row, 0]
                a1 += weight * table[which, level, row, 1]
                a2 += weight * table[which, level, row, 2]
                a3 += weight * table[which, level, row, 3]
            out[m, column] = a0
            out[m, column + 1] = a1
            out[m, column + 2] = a2
            out[m, column + 3] = a3


@njit(fastmath=True)
def encode_rows(points, identity, count, lower, table, inverse_cells, dims, dense, rows_per_level, out):
    """``encode`` of a few points in their parts' frames, on one thread.

    Args:
        points: [≥ count, 3] metres; lower: [I, 3] lower corners; out: [≥ count, L · FEATURES], written.
    """
    mask = np.uint32(rows_per_level - 1)
    zero = np.float32(0.0)
    for level in range(table.shape[1]):
        scale, is_dense = inverse_cells[level], dense[level]
        nx, ny, nz = np.int32(dims[level, 0]), np.int32(dims[level, 1]), np.int32(dims[level, 2])
        column = level * FEATURES
        for m in range(count):
            which = identity[m]
            px = max(points[m, 0] - lower[which, 0], zero) * scale
            py = max(points[m, 1] - lower[which, 1], zero) * scale
            pz = max(points[m, 2] - lower[which, 2], zero) * scale
            ix, iy, iz = np.int32(px), np.int32(py), np.int32(pz)
            if is_dense:
                ix, iy, iz = min(ix, nx - 2), min(iy, ny - 2), min(iz, nz - 2)
            rows = corner_rows(ix, iy, iz, nx, ny, is_dense, mask)
            weights = corner_weights(px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz))
            a0 = a1 = a2 = a3 = zero
            for corner in range(8):
                row, weight = rows[corner], weights[corner]
                a0 += weight * table[which, level, row, 0]
                a1 += weight * table[which, level, row, 1]
                a2 += weight * table[which, level, row, 2]
                a3 += weight * table[which, level, row, 3]
            out[m, column] = a0
            out[m, column + 1] = a1
            out[m, column + 2] = a2
            out[m, column + 3] = a3


@njit(parallel=True, fastmath=True, cache=True)
def encode_backward_table(points, identity, grad_out, inverse_cells, dims, dense, rows_per_level, grad_table):
    """Adds the tables' gradients to ``grad_table`` [I, L, T, FEATURES]; arguments as in ``encode``."""
    mask = np.uint32(rows_per_level - 1)
    for level in prange(grad_table.shape[1]):
        scale, is_dense = inverse_cells[level], dense[level]
        nx, ny, nz = np.int32(dims[level, 0]), np.int32(dims[level, 1]), np.int32(dims[level, 2])
        column = level * FEATURES
        for m in range(len(points)):
            px, py, pz = points[m, 0] * scale, points[m, 1] * scale, points[m, 2] * scale
            ix, iy, iz = np.int32(px), np.int32(py), np.int32(pz)
            if is_dense:
                ix, iy, iz = min(ix, nx - 2), min(iy, ny - 2), min(iz, nz - 2)
            rows = corner_rows(ix, iy, iz, nx, ny, is_dense, mask)
            weights = corner_weights(px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz))
            which = identity[m]
            g0, g1, g2, g3 = (
                grad_out[m, column],
                grad_out[m, column + 1],
                grad_out[m, column + 2],
                grad_out[m, column + 3],
            )
            for corner in range(8):
                row, weight = rows[corner], weights[corner]
                grad_table[which, level, row, 0] += weight * g0
                grad_table[which, level, row, 1] += weight * g1
                grad_table[which, level, row, 2] += weight * g2
                grad_table[which, level, row, 3] += weight * g3


@njit(parallel=True, fastmath=True, cache=True)
def encode_backward_points(points, identity, table, grad_out, inverse_cells, dims, dense, rows_per_level, grad_points):
    """Gradient of the encoding with respect to the points, [M, 3], written; arguments as in ``encode``."""
    levels = table.shape[1]
    mask = np.uint32(rows_per_level - 1)
    one = np.float32(1.0)
    for m in prange(len(points)):
        gx = gy = gz = np.float32(0.0)
        for level in range(levels):
            scale = inverse_cells[level]
            nx, ny, nz = dims[level, 0], dims[level, 1], dims[level, 2]
            is_dense = dense[level]
            px, py, pz = points[m, 0] * scale, points[m, 1] * scale, points[m, 2] * scale
            ix, iy, iz = np.int64(px), np.int64(py), np.int64(pz)
            if is_dense:
                ix, iy, iz = min(ix, nx - 2), min(iy, ny - 2), min(iz, nz - 2)
            fx, fy, fz = px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz)
            column = level * FEATURES
            rows = table[identity[m], level]
            for corner in range(8):
                dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
                wx = fx if dx else one - fx
                wy = fy if dy else one - fy
                wz = fz if dz else one - fz
                row = corner_row(ix + dx, iy + dy, iz + dz, nx, ny, is_dense, mask)
                value = (
                    rows[row, 0] * grad_out[m, column]
                    + rows[row, 1] * grad_out[m, column + 1]
                    + rows[row, 2] * grad_out[m, column + 2]
                    + rows[row, 3] * grad_out[m, column + 3]
                ) * scale
                gx += value * wy * wz * (one if dx else -one)
                gy += value * wx * wz * (one if dy else -one)
                gz += value * wx * wy * (one if dz else -one)
        grad_points[m, 0] = gx
        grad_points[m, 1] = gy
        grad_points[m, 2] = gz

"""Inverse skinning in a voxel volume of blended matrices: Newton with a closed-form Jacobian.

The volume holds one 3×4 matrix a node and pose, ``A = Σ_j w_j T_j`` (with the pose's offset in its last column), and
``f(x) = A(x) [x; 1]`` with A interpolated trilinearly.  Interpolating the blended matrices equals blending with
interpolated weights, because blending is linear in the weights.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from chona_model.kernels.cpu.jit import RELAXED, corner_of, within


@njit(inline="always", fastmath=RELAXED)
def warp(x, y, z, matrices, nodes, first_node, nx, ny, nz, first_row, ox, oy, oz, inverse_cell):
    """f(x) and its Jacobian: (fx, fy, fz, j00, j01, …, j22)."""
    one = np.float32(1.0)
    px = within((x - ox) * inverse_cell, np.float32(nx - 1) - np.float32(1e-3))
    py = within((y - oy) * inverse_cell, np.float32(ny - 1) - np.float32(1e-3))
    pz = within((z - oz) * inverse_cell, np.float32(nz - 1) - np.float32(1e-3))
    ix, iy, iz = corner_of(px, nx), corner_of(py, ny), corner_of(pz, nz)
    u, v, w = px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz)
    f0 = f1 = f2 = np.float32(0.0)
    j00 = j01 = j02 = j10 = j11 = j12 = j20 = j21 = j22 = np.float32(0.0)
    for corner in range(8):
        dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
        wx, wy, wz = (u if dx else one - u), (v if dy else one - v), (w if dz else one - w)
        node = nodes[first_node + (ix + dx) + nx * ((iy + dy) + ny * (iz + dz))]
        a = matrices[first_row + node]
        weight = wx * wy * wz
        gx = (inverse_cell if dx else -inverse_cell) * wy * wz
        gy = (inverse_cell if dy else -inverse_cell) * wx * wz
        gz = (inverse_cell if dz else -inverse_cell) * wx * wy
        v0 = a[0] * x + a[1] * y + a[2] * z + a[3]
        v1 = a[4] * x + a[5] * y + a[6] * z + a[7]
        v2 = a[8] * x + a[9] * y + a[10] * z + a[11]
        f0 += weight * v0
        f1 += weight * v1
        f2 += weight * v2
        j00 += weight * a[0] + gx * v0
        j01 += weight * a[1] + gy * v0
        j02 += weight * a[2] + gz * v0
        j10 += weight * a[4] + gx * v1
        j11 += weight * a[5] + gy * v1
        j12 += weight * a[6] + gz * v1
        j20 += weight * a[8] + gx * v2
        j21 += weight * a[9] + gy * v2
        j22 += weight * a[10] + gz * v2
    return f0, f1, f2, j00, j01, j02, j10, j11, j12, j20, j21, j22


@njit(parallel=True, fastmath=RELAXED, cache=True)
def invert(
    posed, starts, pose, matrices, nodes, first_node, dims, first_row, origins, inverse_cell, steps, tolerance,
    max_step, roots, residuals,
):  # fmt: skip
    """Newton from one start a point; keeps the best iterate.

    Args:
        posed: [M, 3] root-space points, metres; starts: [M, 3] canonical.
        pose: [M] int32 index of each point's pose.
        matrices: [rows, 12 or more] blended matrices of all poses.
        nodes: concatenated node indices of all volumes; first_node, dims [P, 3], first_row, origins [P, 3]: where a
            pose's volume begins in ``nodes``, its size, its first row in ``matrices`` and its lower corner.
        steps: Newton steps at most; tolerance: residual that ends the search, metres; max_step: metres a step.
        roots: [M, 3] and residuals: [M], written.
    """
    for m in prange(len(posed)):
        p = pose[m]
        nx, ny, nz = dims[p, 0], dims[p, 1], dims[p, 2]
        ox, oy, oz = origins[p, 0], origins[p, 1], origins[p, 2]
        x, y, z = starts[m, 0], starts[m, 1], starts[m, 2]
        bx, by, bz, best = x, y, z, np.float32(1e30)
        for step in range(steps + 1):
            f0, f1, f2, a, b, c, d, e, f, g, h, i = warp(
                x, y, z, matrices, nodes, first_node[p], nx, ny, nz, first_row[p], ox, oy, oz, inverse_cell
            )
            r0, r1, r2 = f0 - posed[m, 0], f1 - posed[m, 1], f2 - posed[m, 2]
            residual = np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
            if residual < best:
                bx, by, bz, best = x, y, z, residual
            if residual < tolerance or step == steps:
                break
            c00, c01, c02 = e * i - f * h, c * h - b * i, b * f - c * e
            c10, c11, c12 = f * g - d * i, a * i - c * g, c * d - a * f
            c20, c21, c22 = d * h - e * g, b * g - a * h, a * e - b * d
            determinant = a * c00 + b * c10 + c * c20
            # Blended rotations have determinants near 1; below 0.05 a step would leave the neighbourhood of the start.
            if abs(determinant) < np.float32(0.05):
                determinant = np.float32(0.05) if determinant >= 0 else np.float32(-0.05)
            s0 = (c00 * r0 + c01 * r1 + c02 * r2) / determinant
            s1 = (c10 * r0 + c11 * r1 + c12 * r2) / determinant
            s2 = (c20 * r0 + c21 * r1 + c22 * r2) / determinant
            length = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
            if length > max_step:
                shrink = max_step / length
                s0, s1, s2 = s0 * shrink, s1 * shrink, s2 * shrink
            x, y, z = x - s0, y - s1, z - s2
        roots[m, 0], roots[m, 1], roots[m, 2] = bx, by, bz
        residuals[m] = best


@njit(fastmath=RELAXED, nogil=True, cache=True)
def invert_backward(
    roots, grad_roots, pose, matrices, nodes, first_node, dims, first_row, origins, inverse_cell, min_determinant,
    grad_matrices,
):  # fmt: skip
    """Implicit-function gradient: adds −(J⁻ᵀ g) ⊗ [x; 1], spread trilinearly, to ``grad_matrices`` [rows, 12].

    Roots whose Jacobian's determinant lies under ``min_determinant`` give no gradient.  Single-threaded: it scatters.
    """
    one = np.float32(1.0)
    for m in range(len(roots)):
        p = pose[m]
        nx, ny, nz = dims[p, 0], dims[p, 1], dims[p, 2]
        ox, oy, oz = origins[p, 0], origins[p, 1], origins[p, 2]
        x, y, z = roots[m, 0], roots[m, 1], roots[m, 2]
        _, _, _, a, b, c, d, e, f, g, h, i = warp(
            x, y, z, matrices, nodes, first_node[p], nx, ny, nz, first_row[p], ox, oy, oz, inverse_cell
        )
        c00, c01, c02 = e * i - f * h, c * h - b * i, b * f - c * e
        c10, c11, c12 = f * g - d * i, a * i - c * g, c * d - a * f
        c20, c21, c22 = d * h - e * g, b * g - a * h, a * e - b * d
        determinant = a * c00 + b * c10 + c * c20
        if abs(determinant) < min_determinant:
            continue
        g0, g1, g2 = grad_roots[m, 0], grad_roots[m, 1], grad_roots[m, 2]
        l0 = -(c00 * g0 + c10 * g1 + c20 * g2) / determinant
        l1 = -(c01 * g0 + c11 * g1 + c21 * g2) / determinant
        l2 = -(c02 * g0 + c12 * g1 + c22 * g2) / determinant
        px = within((x - ox) * inverse_cell, np.float32(nx - 1) - np.float32(1e-3))
        py = within((y - oy) * inverse_cell, np.float32(ny - 1) - np.float32(1e-3))
        pz = within((z - oz) * inverse_cell, np.float32(nz - 1) - np.float32(1e-3))
        ix, iy, iz = corner_of(px, nx), corner_of(py, ny), corner_of(pz, nz)
        u, v, w = px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz)
        for corner in range(8):
            dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
            weight = (u if dx else one - u) * (v if dy else one - v) * (w if dz else one - w)
            node = nodes[first_node[p] + (ix + dx) + nx * ((iy + dy) + ny * (iz + dz))]
            row = grad_matrices[first_row[p] + node]
            w0, w1, w2 = weight * l0, weight * l1, weight * l2
            row[0] += w0 * x
            row[1] += w0 * y
            row[2] += w0 * z
            row[3] += w0
            row[4] += w1 * x
            row[5] += w1 * y
            row[6] += w1 * z
            row[7] += w1
            row[8] += w2 * x
            row[9] += w2 * y
            row[10] += w2 * z
            row[11] += w2


@njit(parallel=True, fastmath=RELAXED, cache=True)
def forward(points, matrices, nodes, dims, origin, inverse_cell, out):
    """Forward skinning f(x) of one pose: points [M, 3] canonical to ``out`` [M, 3] root space, metres."""
    for m in prange(len(points)):
        result = warp(
            points[m, 0], points[m, 1], points[m, 2], matrices, nodes, 0, dims[0], dims[1], dims[2], 0,
            origin[0], origin[1], origin[2], inverse_cell,
        )  # fmt: skip
        out[m, 0], out[m, 1], out[m, 2] = result[0], result[1], result[2]

"""Marching rays through posed cells: which points of a ray could hold anything, and where to start their inversion.

*Parts* are identities: persons (local frame: canonical space) and objects (local frame: their own rigid frame). Every
part has an occupancy grid of cached densities; 0 means empty.

Arithmetic here is strict: counting and filling must agree to the last bit, and infinite depths are in use.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from chona_model.kernels.cpu.jit import strict
from chona_model.kernels.cpu.posing import in_camera

BODY = -1
"""Kind of a candidate on the person; objects have their slot's index."""


@strict
def cell_at(x, y, z, part, first, dims, origins, inverse_cell):
    """Index among all parts' cells of the one at a local point of a part; −1 outside its grid."""
    px = (x - origins[part, 0]) * inverse_cell
    py = (y - origins[part, 1]) * inverse_cell
    pz = (z - origins[part, 2]) * inverse_cell
    if not (px >= 0.0 and py >= 0.0 and pz >= 0.0):  # nor is a point that is not a number
        return -1
    nx, ny = dims[part, 0], dims[part, 1]
    # Compared before they become whole numbers: those have no room for 1e30.
    if px >= np.float32(nx) or py >= np.float32(ny) or pz >= np.float32(dims[part, 2]):
        return -1
    ix, iy, iz = np.int64(px), np.int64(py), np.int64(pz)
    return first[part] + ix + nx * (iy + ny * iz)


@strict
def cell_density(x, y, z, part, densities, first, dims, origins, inverse_cell):
    """Cached density of the occupancy cell at a local point of a part; 0 outside its grid."""
    cell = cell_at(x, y, z, part, first, dims, origins, inverse_cell)
    return densities[cell] if cell >= 0 else np.float32(0.0)


@njit(parallel=True, cache=True)
def march(
    fill, origins, directions, near, far, jitter, pose, step,
    grid_starts, grid_first, grid_dims, grid_origins, grid_inverse_cell,
    slot_part, slot_matrix, densities, part_first, part_dims, part_origins, part_inverse_cell,
    first, ray, depth, kind, voxel, points,
):  # fmt: skip
    """Finds the candidates of every ray: with ``fill`` false counts them, with true writes them.

    Args:
        origins, directions: [R, 3] root space, unit length along the camera axis; near, far: [R] depths;
            jitter: [R] in 0…1, shifts the ray's samples by a part of a step; pose: [R] int32; step: metres.
        grid_*: posed start grids of each pose (see ``mark_starts``), concatenated.
        slot_part: [P, N] int32 part in each object slot or −1; slot_matrix: [P, N, 3, 4] root space to its frame.
        densities, part_*: occupancy grids of all parts.
        first: [R + 1] int64: counts are written to first[r + 1]; when filling it holds their cumulative sum.
        ray, kind: [M] int32, depth: [M], voxel: [M] int32 (body candidates: the start), points: [M, 3] (object
            candidates: local point; body candidates: root-space point), written when filling.
    """
    slots = slot_part.shape[1]
    for r in prange(len(origins)):
        p = pose[r]
        d0, d1, d2 = directions[r, 0], directions[r, 1], directions[r, 2]
        dt = step / np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        begin = near[r] + jitter[r] * dt
        gx, gy, gz = grid_dims[p, 0], grid_dims[p, 1], grid_dims[p, 2]
        cursor = first[r] if fill else 0
        samples = 0
        t = begin
        while t < far[r]:
            x, y, z = origins[r, 0] + t * d0, origins[r, 1] + t * d1, origins[r, 2] + t * d2
            px = (x - grid_origins[p, 0]) * grid_inverse_cell
            py = (y - grid_origins[p, 1]) * grid_inverse_cell
            pz = (z - grid_origins[p, 2]) * grid_inverse_cell
            below = px < np.float32(gx) and py < np.float32(gy) and pz < np.float32(gz)
            if px >= 0.0 and py >= 0.0 and pz >= 0.0 and below:
                ix, iy, iz = np.int64(px), np.int64(py), np.int64(pz)
                cell = grid_first[p] + ix + gx * (iy + gy * iz)
                for chance in range(grid_starts.shape[1]):
                    start = grid_starts[cell, chance]
                    if start < 0:
                        break
                    if fill:
                        ray[cursor], depth[cursor], kind[cursor], voxel[cursor] = r, t, BODY, start
                        points[cursor, 0], points[cursor, 1], points[cursor, 2] = x, y, z
                    cursor += 1
            for slot in range(slots):
                part = slot_part[p, slot]
                if part < 0:
                    continue
                a = slot_matrix[p, slot]
                lx = a[0, 0] * x + a[0, 1] * y + a[0, 2] * z + a[0, 3]
                ly = a[1, 0] * x + a[1, 1] * y + a[1, 2] * z + a[1, 3]
                lz = a[2, 0] * x + a[2, 1] * y + a[2, 2] * z + a[2, 3]
                inside = cell_density(
                    lx, ly, lz, part, densities, part_first, part_dims, part_origins, part_inverse_cell
                )
                if inside > 0.0:
                    if fill:
                        ray[cursor], depth[cursor], kind[cursor], voxel[cursor] = r, t, slot, -1
                        points[cursor, 0], points[cursor, 1], points[cursor, 2] = lx, ly, lz
                    cursor += 1
            # Not t += dt: its rounding errors would add up along the ray.
            samples += 1
            t = begin + np.float32(samples) * dt
        if not fill:
            first[r + 1] = cursor


@njit(parallel=True, cache=True)
def prune(
    first, depth, points, part, failed, step, trust, stop, apart,
    densities, part_first, part_dims, part_origins, part_inverse_cell, keep,
):  # fmt: skip
    """Marks the candidates worth a field evaluation.

    Dropped are: points in empty cells, failed roots, roots equal to an earlier one of the same sample, and everything
    behind a wall that cached densities already call opaque.

    Args:
        first: [R + 1]; depth: [M]; points: [M, 3] local points; part: [M] int32; failed: [M] bool.
        step: metres; trust: share of the cached densities that counts (below 1 to stay on the safe side).
        stop: transmittance, by cached densities, behind which nothing is evaluated.
        apart: roots of one sample closer than this are the same one, metres.
        keep: [M] bool, written.
    """
    limit = -np.log(max(stop, np.float32(1e-30)))
    for r in prange(len(first) - 1):
        optical = np.float32(0.0)
        m, end = first[r], first[r + 1]
        while m < end:
            begin = m
            densest = np.float32(0.0)
            while m < end and depth[m] == depth[begin]:
                density = np.float32(0.0)
                if optical < limit and not failed[m]:
                    density = cell_density(
                        points[m, 0], points[m, 1], points[m, 2], part[m],
                        densities, part_first, part_dims, part_origins, part_inverse_cell,
                    )  # fmt: skip
                    for other in range(begin, m):
                        if keep[other] and part[other] == part[m]:
                            a = points[other, 0] - points[m, 0]
                            b = points[other, 1] - points[m, 1]
                            c = points[other, 2] - points[m, 2]
                            if a * a + b * b + c * c < apart * apart:
                                density = np.float32(0.0)
                keep[m] = density > 0.0
                densest = max(densest, density)
                m += 1
            optical += trust * densest * step


@njit(parallel=True, cache=True)
def carve(points, camera_from_root, intrinsics, mask, inside, seen):
    """Visual hull voting: counts for every point in how many views it is seen and falls inside the mask.

    Args:
        points: [M, 3] root space; mask: [H, W] bool; inside, seen: [M] int32, increased.
    """
    height, width = mask.shape
    for m in prange(len(points)):
        x, y, z = in_camera(points, m, camera_from_root)
        if z <= 1e-6:
            continue
        u = np.int64(np.floor(intrinsics[0, 0] * x / z + intrinsics[0, 2]))
        v = np.int64(np.floor(intrinsics[1, 1] * y / z + intrinsics[1, 2]))
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        seen[m] += 1
        if mask[v, u]:
            inside[m] += 1

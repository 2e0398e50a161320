"""What a pose and a camera need before rays are marched: posed start grids and the depth spans of pixels.

Pieces write to their own slab of cells or band of rows and go through all points, so threads never meet.
Arithmetic is strict: ties between voxels must fall the same way everywhere.
"""

from __future__ import annotations

import numpy as np

from chona_model.kernels.cpu.jit import entry, strict


@strict
def _axis_gaps(place, first, last, middles, half, exact, outside):
    """Squared distances along one axis from a point to cells ``first`` to ``last``: to middles and to boxes."""
    for cell in range(first, last):
        gap = place - middles[cell]
        over = max(abs(gap) - half, np.float32(0.0))
        exact[cell - first], outside[cell - first] = gap * gap, over * over


@strict
def _mark(
    chance, begin, end, posed, centres, origin, inverse_cell, dims, reach, apart, starts, distances, taken, middles,
    exact, outside,
):  # fmt: skip
    """Nearest voxel of every cell of a slab; for the second chance, of those far from the first in canonical space."""
    nx, ny = dims[0], dims[1]
    radius = np.int64(np.ceil(reach * inverse_cell))
    limit, spread, half = reach * reach, apart * apart, np.float32(0.5) / inverse_cell
    for v in range(len(posed)):
        cz = np.int64((posed[v, 2] - origin[2]) * inverse_cell)
        if cz + radius < begin or cz - radius >= end:
            continue
        cx = np.int64((posed[v, 0] - origin[0]) * inverse_cell)
        cy = np.int64((posed[v, 1] - origin[1]) * inverse_cell)
        left, right = max(cx - radius, 0), min(cx + radius + 1, nx)
        low, high = max(cy - radius, 0), min(cy + radius + 1, ny)
        near, far = max(cz - radius, begin), min(cz + radius + 1, end)
        _axis_gaps(posed[v, 0], left, right, middles[0], half, exact[0], outside[0])
        _axis_gaps(posed[v, 1], low, high, middles[1], half, exact[1], outside[1])
        _axis_gaps(posed[v, 2], near, far, middles[2], half, exact[2], outside[2])
        for iz in range(near, far):
            k = iz - near
            for iy in range(low, high):
                j = iy - low
                if outside[1, j] + outside[2, k] > limit:
                    continue
                row = nx * (iy + ny * (iz - begin))
                for ix in range(left, right):
                    i = ix - left
                    # To the cell's box, so that every point of a marked cell is covered.
                    if outside[0, i] + outside[1, j] + outside[2, k] > limit:
                        continue
                    distance = exact[0, i] + exact[1, j] + exact[2, k]
                    cell = row + ix
                    if distance >= distances[cell]:
                        continue
                    if chance == 0:
                        taken[cell, 0], taken[cell, 1], taken[cell, 2] = centres[v, 0], centres[v, 1], centres[v, 2]
                    else:
                        d0 = centres[v, 0] - taken[cell, 0]
                        d1 = centres[v, 1] - taken[cell, 1]
                        d2 = centres[v, 2] - taken[cell, 2]
                        if d0 * d0 + d1 * d1 + d2 * d2 <= spread:
                            continue
                    distances[cell] = distance
                    starts[nx * ny * begin + cell, chance] = v


@entry
def mark_starts(begin, end, posed, centres, origin, inverse_cell, dims, reach, apart, starts):
    """Fills the slab ``begin`` ≤ z < ``end`` of a posed grid with the voxels that cells are best inverted from.

    Args:
        posed: [V, 3] root-space centres of the occupied canonical voxels, ``centres`` [V, 3] their canonical ones.
        origin [3], inverse_cell, dims [3]: the posed grid; reach: cells within this distance of a voxel are marked.
        apart: a second start must lie this far from the first in canonical space (a hand on a thigh), metres.
        starts: [cells, chances] int32, the slab written; −1 where there is none.
    """
    first, cells = dims[0] * dims[1] * begin, dims[0] * dims[1] * (end - begin)
    distances, taken = np.empty(cells, np.float32), np.empty((cells, 3), np.float32)
    width = 2 * np.int64(np.ceil(reach * inverse_cell)) + 1
    exact, outside = np.empty((3, width), np.float32), np.empty((3, width), np.float32)
    middles = np.empty((3, dims.max()), np.float32)
    for axis in range(3):
        for cell in range(dims[axis]):
            middles[axis, cell] = origin[axis] + (np.float32(cell) + np.float32(0.5)) / inverse_cell
    for chance in range(starts.shape[1]):
        for cell in range(cells):
            distances[cell] = np.float32(1e30)
            starts[first + cell, chance] = -1
        _mark(chance, begin, end, posed, centres, origin, inverse_cell, dims, reach, apart, starts, distances, taken,
              middles, exact, outside)  # fmt: skip


@strict
def in_camera(points, m, camera_from_root):
    """Point ``m`` of points [M, 3] moved by camera_from_root [3, 4]."""
    x = camera_from_root[0, 3]
    y = camera_from_root[1, 3]
    z = camera_from_root[2, 3]
    for k in range(3):
        x += camera_from_root[0, k] * points[m, k]
        y += camera_from_root[1, k] * points[m, k]
        z += camera_from_root[2, k] * points[m, k]
    return x, y, z


@entry
def splat_spans(top, bottom, points, camera_from_root, intrinsics, orthographic, radius, near, far):
    """Depth spans of the pixels of rows ``top`` to ``bottom`` whose ray may come within ``radius`` of a point.

    Args:
        points: [M, 3] root space; camera_from_root: [3, 4]; intrinsics: [3, 3] pixels; radius: metres.
        near, far: [H, W] updated: start with near = inf, far = 0.
    """
    width = near.shape[1]
    fx, fy, cx, cy = intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]
    for m in range(len(points)):
        x, y, z = in_camera(points, m, camera_from_root)
        if z + radius <= 0.0:
            continue
        begin = max(z - radius, 0.0)
        if orthographic:
            u0, u1, v0, v1 = fx * (x - radius), fx * (x + radius), fy * (y - radius), fy * (y + radius)
        elif z > 1.5 * radius:
            # Slopes of the planes through the camera that touch the sphere.
            square = z * z - radius * radius
            du, dv = radius * np.sqrt(x * x + square), radius * np.sqrt(y * y + square)
            u0, u1 = fx * (x * z - du) / square, fx * (x * z + du) / square
            v0, v1 = fy * (y * z - dv) / square, fy * (y * z + dv) / square
        else:
            u0, u1, v0, v1 = -cx, width - cx, -cy, near.shape[0] - cy  # the camera is inside: every pixel
        left, right = max(np.int64(np.floor(u0 + cx - 0.5)), 0), min(np.int64(np.ceil(u1 + cx - 0.5)), width - 1)
        first, last = max(np.int64(np.floor(v0 + cy - 0.5)), top), min(np.int64(np.ceil(v1 + cy - 0.5)), bottom - 1)
        for row in range(first, last + 1):
            for column in range(left, right + 1):
                near[row, column] = min(near[row, column], begin)
                far[row, column] = max(far[row, column], z + radius)

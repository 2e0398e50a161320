"""Where a ray goes next: the following samples that could hold anything, with their canonical points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from chona_model.kernels.cpu.jit import inlined, inner
from chona_model.kernels.cpu.light import normal_at, unit
from chona_model.kernels.cpu.march import cell_at
from chona_model.kernels.cpu.newton import WORK, find_root, solve_jacobian

RAYS = 128
"""Rays in a block."""

ROOM = 256
"""Candidates a wave may have."""

AHEAD = 4
"""Most samples of one ray in a wave, when few rays are left."""

COLUMNS = 8
"""Of results: premultiplied red, green, blue; alpha; Σ w·depth; Σ w over objects; failed and tried roots."""

PREDICTED = np.float32(0.03)
"""A root is predicted from the ray's last one while the prediction stays this near the cell's own start, metres."""


class Starts(NamedTuple):
    """Posed start grid (see ``posing.mark_starts``), without its empty cells: it must fit a core's cache.

    Attributes:
        row: [cells] int32 row of the cell's starts, −1 where there is none.
        chances: [K] uint8 how many starts a row has; points: [K, chances, 3] float32 canonical starts, metres.
        dims: [3] int64; origin: [3] float32 metres; inverse_cell: 1/m.
    """

    row: np.ndarray
    chances: np.ndarray
    points: np.ndarray
    dims: np.ndarray
    origin: np.ndarray
    inverse_cell: np.float32


class Parts(NamedTuple):
    """Occupancy of all parts, and which of them the pose shows.

    Attributes:
        occupied: [cells] uint8 of all parts, concatenated; first, dims, origins, inverse_cell: their grids (see
            ``render.occupancy.Occupancy``).
        normals: [cells, 3] float32 which way surfaces face, in the parts' frames.
        light: [light.TERMS, 3] float32 of the pose, root space.
        person: part of the person or −1; slot_part: [N] int32 part or −1; slot_matrix: [N, 3, 4] root space to part.
    """

    occupied: np.ndarray
    first: np.ndarray
    dims: np.ndarray
    origins: np.ndarray
    inverse_cell: np.float32
    normals: np.ndarray
    light: np.ndarray
    person: int
    slot_part: np.ndarray
    slot_matrix: np.ndarray


class Block(NamedTuple):
    """State of a block's rays.

    Attributes:
        origin, direction: [RAYS, 3]; begin, far, pace (depth a sample), light (transmittance): [RAYS].
        sample: [RAYS] int64 number of the next sample.
        slot_origin, slot_direction: [RAYS, N, 3] in objects' frames; enter, leave: [RAYS, N] depths of their grids.
        root, slide: [RAYS, chances, 3] last canonical point and its change with depth; root_depth: [RAYS, chances].
        pair: [RAYS, 1 + N] int64 row of the biases for the person, and for each slot's object.
        result: [RAYS, COLUMNS]; alive: [RAYS] int64; work: for ``find_root``.
    """

    origin: np.ndarray
    direction: np.ndarray
    begin: np.ndarray
    far: np.ndarray
    pace: np.ndarray
    light: np.ndarray
    sample: np.ndarray
    slot_origin: np.ndarray
    slot_direction: np.ndarray
    enter: np.ndarray
    leave: np.ndarray
    root: np.ndarray
    slide: np.ndarray
    root_depth: np.ndarray
    pair: np.ndarray
    result: np.ndarray
    alive: np.ndarray
    work: np.ndarray


class Candidates(NamedTuple):
    """Samples that may hold something: in a wave in order of rays and depths.

    Attributes:
        ray: [C] int64; part: [C] int32; pair, pose: [C] int64 rows of conditioned biases.
        thing: [C] bool, on an object; depth: [C]; point: [C, 3] in the part's frame, metres.
        normal: [C, 3] root space, of length one or zero; gain: [C, 3] what the pose's light makes of colours.
        x: [C, E] encoded points; density: [C] 1/m; rgb: [C, 3] in that light.
    """

    ray: np.ndarray
    part: np.ndarray
    pair: np.ndarray
    pose: np.ndarray
    thing: np.ndarray
    depth: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    gain: np.ndarray
    x: np.ndarray
    density: np.ndarray
    rgb: np.ndarray


@njit
def make_block(slots, chances):
    """Memory for a block."""
    real = np.float32
    return Block(
        np.empty((RAYS, 3), real), np.empty((RAYS, 3), real), np.empty(RAYS, real), np.empty(RAYS, real),
        np.empty(RAYS, real), np.empty(RAYS, real), np.empty(RAYS, np.int64), np.empty((RAYS, slots, 3), real),
        np.empty((RAYS, slots, 3), real), np.empty((RAYS, slots), real), np.empty((RAYS, slots), real),
        np.empty((RAYS, chances, 3), real), np.empty((RAYS, chances, 3), real), np.empty((RAYS, chances), real),
        np.zeros((RAYS, 1 + slots), np.int64), np.empty((RAYS, COLUMNS), real), np.empty(RAYS, np.int64),
        np.empty(WORK, real),
    )  # fmt: skip


@njit
def make_candidates(room, inputs, pose):
    """Memory for ``room`` candidates of ``inputs`` encoded features in one pose."""
    real = np.float32
    return Candidates(
        np.zeros(room, np.int64), np.zeros(room, np.int32), np.zeros(room, np.int64), np.full(room, pose, np.int64),
        np.zeros(room, np.bool_), np.zeros(room, real), np.zeros((room, 3), real), np.zeros((room, 3), real),
        np.zeros((room, 3), real), np.zeros((room, inputs), real), np.zeros(room, real), np.zeros((room, 3), real),
    )  # fmt: skip


@inlined
def start_ray(r, near, far, jitter, step, parts, block):
    """A ray whose origin, direction and pairs are set, at its near end, moved on by a share ``jitter`` of a step."""
    square = np.float32(0.0)
    for k in range(3):
        square += block.direction[r, k] * block.direction[r, k]
    block.pace[r] = step / np.sqrt(square)
    block.begin[r] = near + jitter * block.pace[r]
    block.far[r], block.light[r], block.sample[r] = far, np.float32(1.0), 0
    for chance in range(block.root.shape[1]):
        block.root_depth[r, chance] = np.float32(-1.0)
    for slot in range(len(parts.slot_part)):
        if parts.slot_part[slot] >= 0:
            _enter_slot(r, slot, parts, block)
    for k in range(COLUMNS):
        block.result[r, k] = np.float32(0.0)


@inlined
def _enter_slot(r, slot, parts, block):
    """The ray in an object's frame, and where it is inside the object's grid."""
    part = parts.slot_part[slot]
    enter, leave = np.float32(-1e30), np.float32(1e30)
    for k in range(3):
        o, d = parts.slot_matrix[slot, k, 3], np.float32(0.0)
        for j in range(3):
            o += parts.slot_matrix[slot, k, j] * block.origin[r, j]
            d += parts.slot_matrix[slot, k, j] * block.direction[r, j]
        block.slot_origin[r, slot, k], block.slot_direction[r, slot, k] = o, d
        low = parts.origins[part, k]
        high = low + np.float32(parts.dims[part, k]) / parts.inverse_cell
        if abs(d) < np.float32(1e-12):
            if o < low or o > high:
                leave = np.float32(-1e30)
            continue
        a, b = (low - o) / d, (high - o) / d
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    block.enter[r, slot], block.leave[r, slot] = enter, leave


@inlined
def _occupied(x, y, z, part, parts):
    """Whether a point in a part's own frame lies in an occupied cell."""
    cell = cell_at(x, y, z, part, parts.first, parts.dims, parts.origins, parts.inverse_cell)
    return cell >= 0 and parts.occupied[cell] != 0


@inlined
def _invert(r, chance, row, t, x, y, z, volume, starts, limits, block):
    """Canonical point and residual of a posed point, from the ray's last root or else from the cell's start."""
    cx, cy, cz = starts.points[row, chance, 0], starts.points[row, chance, 1], starts.points[row, chance, 2]
    if block.root_depth[r, chance] > np.float32(0.0):
        ahead = t - block.root_depth[r, chance]
        a = block.root[r, chance, 0] + ahead * block.slide[r, chance, 0]
        b = block.root[r, chance, 1] + ahead * block.slide[r, chance, 1]
        c = block.root[r, chance, 2] + ahead * block.slide[r, chance, 2]
        if (a - cx) ** 2 + (b - cy) ** 2 + (c - cz) ** 2 < PREDICTED * PREDICTED:
            cx, cy, cz = a, b, c
    cx, cy, cz, residual = find_root(x, y, z, cx, cy, cz, volume, limits, block.work)
    block.root_depth[r, chance] = np.float32(-1.0)
    if residual <= limits.accept:
        s0, s1, s2 = solve_jacobian(
            block.work, cx, cy, cz, block.direction[r, 0], block.direction[r, 1], block.direction[r, 2]
        )
        block.root_depth[r, chance] = t
        block.root[r, chance, 0], block.root[r, chance, 1], block.root[r, chance, 2] = cx, cy, cz
        block.slide[r, chance, 0], block.slide[r, chance, 1], block.slide[r, chance, 2] = s0, s1, s2
    return cx, cy, cz, residual


@inlined
def _push(found, n, ray, depth, part, pair, thing, x, y, z):
    found.ray[n], found.depth[n], found.part[n], found.pair[n], found.thing[n] = ray, depth, part, pair, thing
    found.point[n, 0], found.point[n, 1], found.point[n, 2] = x, y, z


@inlined
def _face(found, n, x, y, z):
    found.normal[n, 0], found.normal[n, 1], found.normal[n, 2] = unit(x, y, z)


@inner
def _on_body(r, t, row, n, x, y, z, volume, starts, parts, limits, apart, block, found):
    """Candidates of a sample on the person; returns the new number of candidates."""
    before = n
    for chance in range(starts.chances[row]):
        cx, cy, cz, residual = _invert(r, chance, row, t, x, y, z, volume, starts, limits, block)
        block.result[r, 7] += np.float32(1.0)
        if residual > limits.accept:
            block.result[r, 6] += np.float32(1.0)
            continue
        if n > before:  # the same root again, from the other start
            a, b, c = found.point[before, 0] - cx, found.point[before, 1] - cy, found.point[before, 2] - cz
            if a * a + b * b + c * c < apart * apart:
                continue
        if _occupied(cx, cy, cz, parts.person, parts):
            _push(found, n, r, t, parts.person, block.pair[r, 0], False, cx, cy, cz)
            a, b, c = normal_at(cx, cy, cz, parts.person, parts)
            work = block.work  # blended where the root is
            _face(found, n, work[0] * a + work[1] * b + work[2] * c, work[4] * a + work[5] * b + work[6] * c,
                  work[8] * a + work[9] * b + work[10] * c)  # fmt: skip
            n += 1
    return n


@inner
def advance(r, wanted, n, full, volume, starts, parts, limits, apart, block, found):
    """Finds up to ``wanted`` next samples of a ray that could hold anything, for candidates ``n`` up to ``full``.

    Returns:
        The new number of candidates.
    """
    zero = np.float32(0.0)
    nx, ny, nz = starts.dims[0], starts.dims[1], starts.dims[2]
    room = full - starts.points.shape[1] - len(parts.slot_part)
    sample, samples = block.sample[r], 0
    while samples < wanted and n <= room:
        t = block.begin[r] + np.float32(sample) * block.pace[r]
        if t >= block.far[r]:
            break
        sample += 1
        before = n
        x = block.origin[r, 0] + t * block.direction[r, 0]
        y = block.origin[r, 1] + t * block.direction[r, 1]
        z = block.origin[r, 2] + t * block.direction[r, 2]
        px = (x - starts.origin[0]) * starts.inverse_cell
        py = (y - starts.origin[1]) * starts.inverse_cell
        pz = (z - starts.origin[2]) * starts.inverse_cell
        below = px < np.float32(nx) and py < np.float32(ny) and pz < np.float32(nz)
        if px >= zero and py >= zero and pz >= zero and below:
            ix, iy, iz = np.int64(px), np.int64(py), np.int64(pz)
            row = starts.row[ix + nx * (iy + ny * iz)]
            if row >= 0:
                n = _on_body(r, t, row, n, x, y, z, volume, starts, parts, limits, apart, block, found)
        for slot in range(len(parts.slot_part)):
            part = parts.slot_part[slot]
            if part < 0 or t < block.enter[r, slot] or t > block.leave[r, slot]:
                continue
            lx = block.slot_origin[r, slot, 0] + t * block.slot_direction[r, slot, 0]
            ly = block.slot_origin[r, slot, 1] + t * block.slot_direction[r, slot, 1]
            lz = block.slot_origin[r, slot, 2] + t * block.slot_direction[r, slot, 2]
            if _occupied(lx, ly, lz, part, parts):
                _push(found, n, r, t, part, block.pair[r, slot + 1], True, lx, ly, lz)
                a, b, c = normal_at(lx, ly, lz, part, parts)
                m = parts.slot_matrix
                _face(found, n, m[slot, 0, 0] * a + m[slot, 1, 0] * b + m[slot, 2, 0] * c,
                      m[slot, 0, 1] * a + m[slot, 1, 1] * b + m[slot, 2, 1] * c,
                      m[slot, 0, 2] * a + m[slot, 1, 2] * b + m[slot, 2, 2] * c)  # fmt: skip
                n += 1
        if n > before:
            samples += 1
    block.sample[r] = sample
    return n

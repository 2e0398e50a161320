"""Whole rays on the CPU: march, invert, evaluate and integrate a block of rays in waves, all of it in the cache.

In each wave every ray that light still passes advances to its next sample that could hold anything; the field is
evaluated for all of them together, sixteen lanes wide; then transmittance decides who goes on.  So nothing behind a
surface is ever evaluated, as with ``kernels.cpu.integrate``'s early stop, but before paying for it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chona_model.kernels.cpu.advance import COLUMNS, RAYS, ROOM, advance, aim, make_block, make_candidates
from chona_model.kernels.cpu.encode import encode_level
from chona_model.kernels.cpu.jit import entry, inner
from chona_model.kernels.cpu.newton import RootLimits
from chona_model.kernels.cpu.perceptron import BLOCK, forward_block, make_activations

AHEAD = 4
"""Most samples of one ray in a wave, when few rays are left."""


class Tables(NamedTuple):
    """Grid encoding of all parts.

    Attributes:
        table: [I, L, T, F]; lower: [I, 3] lower corners.
        inverse_cells, dims, dense, rows: the layout (see ``kernels.grid.GridLayout``).
        scale: of the density, 1/m.
    """

    table: np.ndarray
    lower: np.ndarray
    inverse_cells: np.ndarray
    dims: np.ndarray
    dense: np.ndarray
    rows: int
    scale: np.float32


class Limits(NamedTuple):
    """Distance between samples, metres; transmittance that ends a ray; roots of one sample nearer than ``apart``,
    metres, are one; Newton's."""

    step: np.float32
    stop: np.float32
    apart: np.float32
    root: RootLimits


@inner
def _evaluate(n, tables, net, found, x, act, density, rgb):
    """Density and colour of the wave's candidates."""
    for level in range(tables.table.shape[1]):
        encode_level(
            level, found.point, found.part, 0, n, tables.lower, tables.table, tables.inverse_cells, tables.dims,
            tables.dense, tables.rows, x,
        )  # fmt: skip
    for first in range(0, n, BLOCK):
        rows = min(BLOCK, n - first)
        forward_block(net, x, first * x.shape[1], rows, found.pair, found.pose, first, act)
        for m in range(rows):
            density[first + m] = tables.scale * act.final[0, m]
            for k in range(3):
                rgb[first + m, k] = act.final[1 + k, m] * act.final[4, m]


@inner
def _integrate(n, limits, found, density, rgb, block):
    """Adds the wave to its rays; of several candidates of one sample the densest counts."""
    m = 0
    while m < n:
        r, chosen = found.ray[m], m
        m += 1
        while m < n and found.ray[m] == r and found.depth[m] == found.depth[chosen]:
            if density[m] > density[chosen]:
                chosen = m
            m += 1
        light = block.light[r]
        if light < limits.stop:
            continue
        alpha = -np.expm1(-density[chosen] * limits.step)
        weight = light * alpha
        for k in range(3):
            block.result[r, k] += weight * rgb[chosen, k]
        block.result[r, 3] += weight
        block.result[r, 4] += weight * found.depth[chosen]
        if found.thing[chosen]:
            block.result[r, 5] += weight
        block.light[r] = light * (np.float32(1.0) - alpha)


@inner
def _render_block(
    first, count, rays, volume, starts, parts, tables, net, limits, block, found, x, act, density, rgb, alive, out
):  # fmt: skip
    """Renders ``count`` rays from ``first``; returns how often the field was evaluated."""
    aim(rays, parts, limits.step, first, count, block)
    living, evaluated = count, 0
    for r in range(count):
        alive[r] = r
    while living > 0:
        wanted = min(max(RAYS // living, 1), AHEAD)
        n = 0
        for index in range(living):
            n = advance(alive[index], wanted, n, volume, starts, parts, limits.root, limits.apart, block, found)
        _evaluate(n, tables, net, found, x, act, density, rgb)
        _integrate(n, limits, found, density, rgb, block)
        evaluated += n
        left = 0
        for index in range(living):
            r = alive[index]
            depth = block.begin[r] + np.float32(block.sample[r]) * block.pace[r]
            if block.light[r] >= limits.stop and depth < block.far[r]:
                alive[left] = r
                left += 1
        living = left
    for r in range(count):
        for k in range(COLUMNS):
            out[(first + r) // (rays.side * rays.side), k] += block.result[r, k]
    return evaluated


@entry
def render(begin, end, rays, volume, starts, parts, tables, net, limits, out):
    """Renders the pixels ``begin`` to ``end`` of ``rays``.

    Args:
        rays, volume, starts, parts, tables, net, limits: see their types.
        out: [R, COLUMNS] sums over a pixel's rays, zero at first.

    Returns:
        How often the field was evaluated.
    """
    block, found = make_block(len(parts.slot_part), starts.starts.shape[1]), make_candidates()
    act, x = make_activations(net), np.zeros((ROOM, net.both.shape[0]), np.float32)
    density, rgb = np.empty(ROOM, np.float32), np.empty((ROOM, 3), np.float32)
    alive = np.empty(RAYS, np.int64)
    a_pixel, evaluated = rays.side * rays.side, 0
    for first in range(begin * a_pixel, end * a_pixel, RAYS):
        evaluated += _render_block(
            first, min(RAYS, end * a_pixel - first), rays, volume, starts, parts, tables, net, limits, block, found, x,
            act, density, rgb, alive, out,
        )  # fmt: skip
    return evaluated

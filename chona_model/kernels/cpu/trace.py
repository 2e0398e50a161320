"""Whole rays on the CPU: march, invert, evaluate and integrate a block of rays in waves, all of it in the cache.

In each wave every ray that light still passes advances to its next sample that could hold anything; the field is
evaluated for all of them together, sixteen lanes wide; then transmittance decides who goes on.  So nothing behind a
surface is ever evaluated, as with ``kernels.cpu.integrate``'s early stop, but before paying for it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chona_model.kernels.cpu.advance import (
    AHEAD,
    RAYS,
    ROOM,
    advance,
)  # fmt: skip
from chona_model.kernels.cpu.encode import encode_level
from chona_model.kernels.cpu.jit import inner
from chona_model.kernels.cpu.light import log_gain
from chona_model.kernels.cpu.newton import RootLimits
from chona_model.kernels.cpu.perceptron import BLOCK, forward_block


class Tables(NamedTuple):
    """Grid encoding of all parts.

    Attributes:
        of: [parts] int32 the table that each part reads.
        table: [I, L, T, F]; lower: [I, 3] lower corners, metres.
        inverse_cells, dims, dense, rows: the layout (see ``kernels.grid.GridLayout``).
        scale: of the density, 1/m.
    """

    of: np.ndarray
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
def _evaluate(begin, end, light, tables, net, found, act):
    """Encodes candidates, and their density and colour."""
    for level in range(tables.table.shape[1]):
        encode_level(
            level, found.point, found.part, begin, end, tables.of, tables.lower, tables.table, tables.inverse_cells,
            tables.dims, tables.dense, tables.rows, found.x,
        )  # fmt: skip
    for first in range(begin, end, BLOCK):
        rows = min(BLOCK, end - first)
        forward_block(net, found.x, first * found.x.shape[1], rows, found.pair, found.pose, first, act)
        for m in range(rows):
            found.density[first + m] = tables.scale * act.final[0, m]
            x, y, z = found.normal[first + m, 0], found.normal[first + m, 1], found.normal[first + m, 2]
            for k in range(3):
                found.gain[first + m, k] = np.exp(log_gain(x, y, z, light, k))
                found.rgb[first + m, k] = act.final[1 + k, m] * act.final[4, m] * found.gain[first + m, k]


@inner
def _integrate(begin, end, limits, found, block):
    """Adds candidates to their rays; of several of one sample the densest counts."""
    m = begin
    while m < end:
        r, chosen = found.ray[m], m
        m += 1
        while m < end and found.ray[m] == r and found.depth[m] == found.depth[chosen]:
            if found.density[m] > found.density[chosen]:
                chosen = m
            m += 1
        light = block.light[r]
        if light < limits.stop:
            continue
        alpha = -np.expm1(-found.density[chosen] * limits.step)
        weight = light * alpha
        for k in range(3):
            block.result[r, k] += weight * found.rgb[chosen, k]
        block.result[r, 3] += weight
        block.result[r, 4] += weight * found.depth[chosen]
        if found.thing[chosen]:
            block.result[r, 5] += weight
        block.light[r] = light * (np.float32(1.0) - alpha)


@inner
def trace_block(count, keep, n, volume, starts, parts, tables, net, limits, block, found, act):
    """Traces a block whose ``count`` rays are ready.

    Args:
        keep: whether candidates are kept, after the ``n`` there are; else each wave overwrites the last.

    Returns:
        candidates in ``found``, or −1 where they need more room; and how often the field was evaluated.
    """
    living, evaluated = count, 0
    for r in range(count):
        block.alive[r] = r
    while living > 0:
        begin = n if keep else 0
        if begin + ROOM > len(found.ray):
            return -1, evaluated
        wanted = min(max(RAYS // living, 1), AHEAD)
        n = begin
        for index in range(living):
            n = advance(
                block.alive[index], wanted, n, begin + ROOM, volume, starts, parts, limits.root, limits.apart, block,
                found,
            )  # fmt: skip
        _evaluate(begin, n, parts.light, tables, net, found, act)
        _integrate(begin, n, limits, found, block)
        evaluated += n - begin
        left = 0
        for index in range(living):
            r = block.alive[index]
            depth = block.begin[r] + np.float32(block.sample[r]) * block.pace[r]
            if block.light[r] >= limits.stop and depth < block.far[r]:
                block.alive[left] = r
                left += 1
        living = left
    return n, evaluated

"""The grid field's perceptrons on blocks of rows that stay in the first-level cache, forward and backward.

Layers are named as in ``FieldWeights``: ``both`` is the first layer of density and colour side by side, ``raw``
density and geometry features, ``features`` their way into the colour's hidden layer.  Outputs narrower than a vector
are padded with zero columns.  The backward pass computes activations again: cheaper than writing them out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from chona_model.kernels.cpu.jit import entry, inlined, inner
from chona_model.kernels.cpu.matmul import add_product
from chona_model.kernels.cpu.simd import LANES, load, maximum, sigmoid, softplus, splat, store, where_positive

BLOCK = 64
"""Rows computed at once."""


class Network(NamedTuple):
    """Weights, input rows by output columns, float32; Q pairs, P poses.

    Attributes:
        both [E, 2 H], both_bias [Q, 2 H]; raw [H, 16], raw_bias [16]; features [16, H], row 0 zero.
        colour [H, 16], colour_bias [16]: three columns count; shade_in [16, S], row 0 zero, shade_bias [P, S];
            shade_out [S, 16], shade_out_bias [16]: one column counts; P = 0 leaves the shading out.
    """

    both: np.ndarray
    both_bias: np.ndarray
    raw: np.ndarray
    raw_bias: np.ndarray
    features: np.ndarray
    colour: np.ndarray
    colour_bias: np.ndarray
    shade_in: np.ndarray
    shade_bias: np.ndarray
    shade_out: np.ndarray
    shade_out_bias: np.ndarray


class Transposed(NamedTuple):
    """Weights that the backward pass multiplies with, output rows by input columns."""

    both: np.ndarray
    raw: np.ndarray
    features: np.ndarray
    colour: np.ndarray
    shade_in: np.ndarray
    shade_out: np.ndarray


class Activations(NamedTuple):
    """One block's: both [BLOCK, 2 H], raw [BLOCK, 16], shade [BLOCK, S], out and occlusion [BLOCK, 16], and results as
    rows of lanes, final [5, BLOCK]: density before scaling, red, green, blue, shading."""

    both: np.ndarray
    raw: np.ndarray
    shade: np.ndarray
    out: np.ndarray
    occlusion: np.ndarray
    final: np.ndarray


@njit
def make_activations(net):
    """Memory for one block."""
    return Activations(
        np.empty((BLOCK, net.both.shape[1]), np.float32),
        np.empty((BLOCK, LANES), np.float32),
        np.empty((BLOCK, net.shade_in.shape[1]), np.float32),
        np.empty((BLOCK, LANES), np.float32),
        np.empty((BLOCK, LANES), np.float32),
        np.zeros((5, BLOCK), np.float32),
    )


@inlined
def _copy_row(source, source_begin, target, target_begin, count):
    for k in range(0, count, LANES):
        store(target, target_begin + k, load(source, source_begin + k))


@inner
def _clear(values):
    zero = splat(np.float32(0.0))
    for k in range(0, values.size, LANES):
        store(values, k, zero)


@inner
def _rectify(values, begin, row, rows, columns):
    zero = splat(np.float32(0.0))
    for r in range(rows):
        for k in range(begin + r * row, begin + r * row + columns, LANES):
            store(values, k, maximum(load(values, k), zero))


@inner
def forward_block(net, x, x_begin, rows, pair, pose, first, act):
    """Activations of up to ``BLOCK`` encoded points.

    Args:
        x: [·, E] encoded points, from element ``x_begin``; finite up to the next multiple of 4 rows.
        pair, pose: of all points; the block's begin at ``first``.
        act: written.
    """
    inputs, wide = net.both.shape
    hidden, shades = net.raw.shape[0], net.shade_in.shape[1]
    shaded = len(net.shade_bias) > 0
    padded = (rows + 3) // 4 * 4
    for r in range(padded):
        m = first + min(r, rows - 1)
        _copy_row(net.both_bias, pair[m] * wide, act.both, r * wide, wide)
        _copy_row(net.raw_bias, 0, act.raw, r * LANES, LANES)
        _copy_row(net.colour_bias, 0, act.out, r * LANES, LANES)
        if shaded:
            _copy_row(net.shade_bias, pose[m] * shades, act.shade, r * shades, shades)
            _copy_row(net.shade_out_bias, 0, act.occlusion, r * LANES, LANES)
    add_product(x, x_begin, inputs, 1, net.both, 0, wide, act.both, 0, wide, padded, wide, inputs)
    _rectify(act.both, 0, wide, padded, hidden)
    add_product(act.both, 0, wide, 1, net.raw, 0, LANES, act.raw, 0, LANES, padded, LANES, hidden)
    add_product(act.raw, 0, LANES, 1, net.features, 0, hidden, act.both, hidden, wide, padded, hidden, LANES)
    _rectify(act.both, hidden, wide, padded, hidden)
    add_product(act.both, hidden, wide, 1, net.colour, 0, LANES, act.out, 0, LANES, padded, LANES, hidden)
    if shaded:
        add_product(act.raw, 0, LANES, 1, net.shade_in, 0, shades, act.shade, 0, shades, padded, shades, LANES)
        _rectify(act.shade, 0, shades, padded, shades)
        add_product(act.shade, 0, shades, 1, net.shade_out, 0, LANES, act.occlusion, 0, LANES, padded, LANES, shades)
    for r in range(rows):
        act.final[0, r] = act.raw[r, 0] - np.float32(1.0)
        act.final[1, r], act.final[2, r], act.final[3, r] = act.out[r, 0], act.out[r, 1], act.out[r, 2]
        act.final[4, r] = act.occlusion[r, 0] if shaded else np.float32(0.0)
    one = splat(np.float32(1.0))
    for r in range(0, rows, LANES):
        store(act.final, r, softplus(load(act.final, r)))
        for row in range(1, 4):
            store(act.final, row * BLOCK + r, sigmoid(load(act.final, row * BLOCK + r)))
        store(act.final, 4 * BLOCK + r, sigmoid(load(act.final, 4 * BLOCK + r)) if shaded else one)


@inner
def _copy_block(x, first, rows, block):
    """Rows of ``x`` [M, E] to ``block``; where there are fewer than a block's, padded with zeros."""
    inputs = x.shape[1]
    if rows < BLOCK:
        _clear(block)
    _copy_row(x, first * inputs, block, 0, rows * inputs)


@entry
def forward(net, x, begin, end, pair, pose, scale, density, rgb):
    """Density [M] and rgb [M, 3] of the encoded points ``begin`` to ``end`` of x [M, E].

    Args:
        pair, pose: [M] int64 rows of the biases.
    """
    act, block = make_activations(net), np.empty((BLOCK, x.shape[1]), np.float32)
    for first in range(begin, end, BLOCK):
        rows = min(BLOCK, end - first)
        _copy_block(x, first, rows, block)
        forward_block(net, block, 0, rows, pair, pose, first, act)
        for r in range(rows):
            density[first + r] = scale * act.final[0, r]
            for k in range(3):
                rgb[first + r, k] = act.final[1 + k, r] * act.final[4, r]


@inlined
def _add_row(source, source_begin, target, target_begin, count):
    for k in range(0, count, LANES):
        store(target, target_begin + k, load(target, target_begin + k) + load(source, source_begin + k))


@inner
def _mask(condition, condition_begin, condition_row, values, begin, row, rows, columns):
    """Keeps gradients where the rectified activation is above zero."""
    for r in range(rows):
        for k in range(0, columns, LANES):
            kept = where_positive(
                load(condition, condition_begin + r * condition_row + k), load(values, begin + r * row + k)
            )
            store(values, begin + r * row + k, kept)


@entry
def backward(net, transposed, x, begin, end, pair, pose, scale, grad_density, grad_rgb, grad_x, sums):
    """Gradients of ``forward``.

    Args:
        grad_density: [M]; grad_rgb: [M, 3].
        grad_x: [M, E] written.
        sums: a ``Network`` of the weights' gradients, added to.
    """
    inputs, wide = net.both.shape
    hidden, shades = net.raw.shape[0], net.shade_in.shape[1]
    shaded = len(net.shade_bias) > 0
    one, zero = np.float32(1.0), np.float32(0.0)
    act = make_activations(net)
    block, grad_block = np.empty((BLOCK, inputs), np.float32), np.empty((BLOCK, inputs), np.float32)
    grad_both, grad_shade = np.empty((BLOCK, wide), np.float32), np.empty((BLOCK, shades), np.float32)
    grad_raw, grad_out, grad_occlusion = (
        np.empty((BLOCK, LANES), np.float32), np.empty((BLOCK, LANES), np.float32),
        np.empty((BLOCK, LANES), np.float32),
    )  # fmt: skip
    for first in range(begin, end, BLOCK):
        rows = min(BLOCK, end - first)
        padded = (rows + 3) // 4 * 4
        _copy_block(x, first, rows, block)
        forward_block(net, block, 0, rows, pair, pose, first, act)
        for array in (grad_both, grad_shade, grad_raw, grad_out, grad_occlusion, grad_block):
            _clear(array)
        for r in range(rows):
            shade, through = act.final[4, r], zero
            for k in range(3):
                value, grad = act.final[1 + k, r], grad_rgb[first + r, k]
                through += grad * value
                grad_out[r, k] = grad * shade * value * (one - value)
            grad_occlusion[r, 0] = through * shade * (one - shade)
        if shaded:
            # Only the first column counts; depth is even.
            add_product(grad_occlusion, 0, LANES, 1, transposed.shade_out, 0, shades,
                        grad_shade, 0, shades, padded, shades, 2)  # fmt: skip
            _mask(act.shade, 0, shades, grad_shade, 0, shades, rows, shades)
            add_product(act.shade, 0, 1, shades, grad_occlusion, 0, LANES,
                        sums.shade_out, 0, LANES, shades, LANES, padded)  # fmt: skip
            add_product(act.raw, 0, 1, LANES, grad_shade, 0, shades, sums.shade_in, 0, shades, LANES, shades, padded)
            add_product(grad_shade, 0, shades, 1, transposed.shade_in, 0, LANES,
                        grad_raw, 0, LANES, padded, LANES, shades)  # fmt: skip
            for r in range(rows):
                _add_row(grad_shade, r * shades, sums.shade_bias, pose[first + r] * shades, shades)
                _add_row(grad_occlusion, r * LANES, sums.shade_out_bias, 0, LANES)
        add_product(grad_out, 0, LANES, 1, transposed.colour, 0, hidden,
                    grad_both, hidden, wide, padded, hidden, 4)  # fmt: skip
        _mask(act.both, hidden, wide, grad_both, hidden, wide, rows, hidden)
        add_product(act.both, hidden, 1, wide, grad_out, 0, LANES, sums.colour, 0, LANES, hidden, LANES, padded)
        add_product(act.raw, 0, 1, LANES, grad_both, hidden, wide, sums.features, 0, hidden, LANES, hidden, padded)
        add_product(grad_both, hidden, wide, 1, transposed.features, 0, LANES,
                    grad_raw, 0, LANES, padded, LANES, hidden)  # fmt: skip
        for r in range(rows):
            # softplus' derivative is 1 − e^−softplus
            grad_raw[r, 0] = grad_density[first + r] * scale * -np.expm1(-act.final[0, r])
        add_product(act.both, 0, 1, wide, grad_raw, 0, LANES, sums.raw, 0, LANES, hidden, LANES, padded)
        add_product(grad_raw, 0, LANES, 1, transposed.raw, 0, hidden, grad_both, 0, wide, padded, hidden, LANES)
        _mask(act.both, 0, wide, grad_both, 0, wide, rows, hidden)
        add_product(block, 0, 1, inputs, grad_both, 0, wide, sums.both, 0, wide, inputs, wide, padded)
        for r in range(rows):
            _add_row(grad_both, r * wide, sums.both_bias, pair[first + r] * wide, wide)
            _add_row(grad_raw, r * LANES, sums.raw_bias, 0, LANES)
            _add_row(grad_out, r * LANES, sums.colour_bias, 0, LANES)
        add_product(grad_both, 0, wide, 1, transposed.both, 0, inputs,
                    grad_block, 0, inputs, padded, inputs, wide)  # fmt: skip
        _copy_row(grad_block, 0, grad_x, first * inputs, rows * inputs)

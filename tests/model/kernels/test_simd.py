"""Vectors inside numba functions against float64, and products against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from chona_model.kernels.cpu import simd
from chona_model.kernels.cpu.matmul import ROWS, add_product


@njit
def map_lanes(which, x, y):
    for i in range(0, len(x), simd.LANES):
        value = simd.load(x, i)
        if which == 0:
            value = simd.exp(value)
        elif which == 1:
            value = simd.sigmoid(value)
        elif which == 2:
            value = simd.softplus(value)
        simd.store(y, i, value)


FUNCTIONS = (np.exp, lambda x: 1 / (1 + np.exp(-x)), lambda x: np.logaddexp(0, x))


@pytest.mark.parametrize("which", [0, 1, 2])
def test_functions_are_within_a_few_units_in_the_last_place(which: int) -> None:
    x = np.concatenate([np.linspace(-80, 80, 32000), np.linspace(-1e-3, 1e-3, 32000)]).astype(np.float32)
    y = np.empty_like(x)
    map_lanes(which, x, y)
    np.testing.assert_allclose(y, FUNCTIONS[which](x.astype(np.float64)), rtol=4e-7)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_functions_stay_finite_at_the_extremes(which: int) -> None:
    x = np.full(16, 0, dtype=np.float32)
    x[:6] = [-1e30, -1e4, -100, 100, 1e4, 3e38]
    y = np.empty_like(x)
    map_lanes(which, x, y)
    assert np.isfinite(y).all()
    if which == 1:
        np.testing.assert_allclose(y[:6], [0, 0, 0, 1, 1, 1], atol=1e-30)
    if which == 2:
        np.testing.assert_allclose(y[:6], [0, 0, 0, 100, 1e4, 3e38], atol=1e-30)


@njit
def four(a, b, out):
    simd.store(out, 0, simd.fma(simd.load4(a, 1), simd.splat4(b[0]), simd.load4(b, 2) - simd.load4(a, 0)))
    big = (simd.load(a, 0) + simd.splat_at(b, 3)) / simd.splat(np.float32(2.0)) * simd.load(b, 0)
    simd.store(out, 4, simd.where_positive(simd.load(b, 0), simd.minimum(big, simd.maximum(simd.load(a, 0), big))))


def test_operators_and_offsets() -> None:
    random = np.random.default_rng(0)
    a, b = random.normal(size=(2, 32)).astype(np.float32)
    out = np.zeros(20, dtype=np.float32)
    four(a, b, out)
    np.testing.assert_allclose(out[:4], a[1:5] * b[0] + b[2:6] - a[:4], rtol=1e-6)
    big = (a[:16] + b[3]) / 2 * b[:16]
    np.testing.assert_allclose(out[4:], np.where(b[:16] > 0, np.minimum(big, np.maximum(a[:16], big)), 0), rtol=1e-6)


@njit
def multiply(a, a0, a_row, a_depth, b, c, rows, columns, depth):
    add_product(a, a0, a_row, a_depth, b, 0, columns, c, 0, columns, rows, columns, depth)


@pytest.mark.parametrize("columns", [16, 32, 48, 64])
@pytest.mark.parametrize("depth", [1, 2, 15, 64])
@pytest.mark.parametrize("rows", [ROWS, 5 * ROWS])
def test_products_add_to_what_is_there(rows: int, columns: int, depth: int) -> None:
    random = np.random.default_rng(rows + columns + depth)
    a, b = random.normal(size=(rows, depth)).astype(np.float32), random.normal(size=(depth, columns)).astype(np.float32)
    c = random.normal(size=(rows, columns)).astype(np.float32)
    expected = c + a.astype(np.float64) @ b
    result = c.copy()
    multiply(a, 0, depth, 1, b, result, rows, columns, depth)
    np.testing.assert_allclose(result, expected, atol=2e-5)
    transposed = c.copy()
    multiply(np.ascontiguousarray(a.T), 0, 1, rows, b, transposed, rows, columns, depth)
    np.testing.assert_array_equal(transposed, result)


def test_products_of_a_part_leave_the_rest_alone() -> None:
    a, b = np.ones((8, 6), np.float32), np.ones((3, 16), np.float32)
    c = np.zeros((4, 16), np.float32)
    multiply(a, 6 + 2, 6, 1, b, c, 4, 16, 3)
    assert (c == 3).all()

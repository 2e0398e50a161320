"""The grid encoding: fast kernel against torch twin, twin against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.grid import FEATURES, GridLayout, TableGradient, encode, make_layout

EXTENT = np.array([0.9, 1.1, 0.7])
IDENTITIES = 3


def layout() -> GridLayout:
    """Two dense and three hashed levels."""
    made = make_layout(EXTENT, coarsest=0.2, finest=0.012, levels=5, rows=1024)
    assert made.dense.any() and not made.dense.all()
    return made


def inputs(seed: int, count: int = 5000) -> tuple[Tensor, Tensor, Tensor]:
    """Points, identities and a table; more points than one chunk of the kernel."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.rand(count, 3, generator=generator) * torch.from_numpy(EXTENT).float()
    identity = torch.randint(0, IDENTITIES, (count,), generator=generator, dtype=torch.int32)
    table = torch.randn(IDENTITIES, 5, 1024, FEATURES, generator=generator)
    return points, identity, table


def border_points(shape: GridLayout) -> Tensor:
    """Points on corners of the coarsest cells, on the lower and on the upper faces of the box."""
    steps = torch.arange(4.0) / float(shape.inverse_cells[0])
    corners = torch.cartesian_prod(steps, steps, steps[:3])
    extent = torch.from_numpy(EXTENT).float()
    faces = torch.rand(60, 3, generator=torch.Generator().manual_seed(1)) * extent
    faces[:30, 0], faces[15:45, 1], faces[40:, 2] = 0.0, extent[1], extent[2]
    return torch.cat([corners, faces, extent[None], torch.zeros(1, 3)])


@pytest.mark.parametrize("seed", range(3))
def test_values_equal_the_twin(seed: int) -> None:
    points, identity, table = inputs(seed)
    torch.testing.assert_close(
        encode(points, identity, table, layout()), reference.encode(points, identity, table, layout())
    )


def test_borders_equal_the_twin() -> None:
    points = border_points(layout())
    identity = torch.zeros(len(points), dtype=torch.int32)
    table = inputs(0)[2]
    torch.testing.assert_close(
        encode(points, identity, table, layout()), reference.encode(points, identity, table, layout())
    )


def test_a_dense_corner_reads_its_own_row() -> None:
    shape = layout()
    table = inputs(0)[2]
    corner = np.array([2, 3, 1])
    points = torch.from_numpy((corner / shape.inverse_cells[0]).astype(np.float32))[None]
    row = corner[0] + shape.dims[0, 0] * (corner[1] + shape.dims[0, 1] * corner[2])
    found = encode(points, torch.tensor([1], dtype=torch.int32), table, shape)[0, :FEATURES]
    torch.testing.assert_close(found, table[1, 0, row], rtol=1e-4, atol=1e-5)


def test_affine_functions_are_interpolated_exactly() -> None:
    shape = layout()
    table = torch.zeros(1, shape.levels, shape.rows, FEATURES)
    for level in np.flatnonzero(shape.dense):
        nx, ny, nz = shape.dims[level]
        z, y, x = np.meshgrid(*(np.arange(n) / shape.inverse_cells[level] for n in (nz, ny, nx)), indexing="ij")
        values = np.stack([x, y, z, 2 * x - y + 0.5 * z + 1], axis=-1).reshape(-1, FEATURES)
        table[0, level, : len(values)] = torch.from_numpy(values)
    points = inputs(4)[0]
    found = encode(points, torch.zeros(len(points), dtype=torch.int32), table, shape)
    x, y, z = points.unbind(dim=-1)
    expected = torch.stack([x, y, z, 2 * x - y + 0.5 * z + 1], dim=-1)
    for level in np.flatnonzero(shape.dense):
        torch.testing.assert_close(found[:, level * FEATURES : (level + 1) * FEATURES], expected, rtol=1e-5, atol=1e-5)


def gradients(points: Tensor, identity: Tensor, table: Tensor, upstream: Tensor) -> tuple[Tensor, ...]:
    """Gradients to points and table of the fast kernel, then those of the twin."""
    leaf, gradient = points.clone().requires_grad_(), TableGradient(table)
    encode(leaf, identity, table.clone().requires_grad_(), layout(), gradient).backward(upstream)
    other, other_table = points.clone().requires_grad_(), table.clone().requires_grad_()
    reference.encode(other, identity, other_table, layout()).backward(upstream)
    assert leaf.grad is not None and other.grad is not None and other_table.grad is not None
    return leaf.grad, gradient.buffer, other.grad, other_table.grad


@pytest.mark.parametrize("seed", range(3))
def test_gradients_equal_the_twin(seed: int) -> None:
    points, identity, table = inputs(seed)
    upstream = torch.randn(len(points), 5 * FEATURES, generator=torch.Generator().manual_seed(seed + 10))
    fast_points, fast_table, slow_points, slow_table = gradients(points, identity, table, upstream)
    torch.testing.assert_close(fast_points, slow_points, rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(fast_table, slow_table, rtol=1e-4, atol=1e-4)


def test_gradients_on_borders_equal_the_twin() -> None:
    points, table = border_points(layout()), inputs(0)[2]
    upstream = torch.ones(len(points), 5 * FEATURES)
    fast_points, fast_table, slow_points, slow_table = gradients(
        points, torch.ones(len(points), dtype=torch.int32), table, upstream
    )
    torch.testing.assert_close(fast_points, slow_points, rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(fast_table, slow_table, rtol=1e-4, atol=1e-4)


def test_table_gradients_add_up() -> None:
    points, identity, table = inputs(0)
    table.requires_grad_()
    gradient = TableGradient(table)
    encode(points, identity, table, layout(), gradient).sum().backward()
    once = gradient.buffer.clone()
    encode(points, identity, table, layout(), gradient).sum().backward()
    torch.testing.assert_close(gradient.buffer, 2 * once, rtol=1e-4, atol=1e-4)


def test_without_a_buffer_the_table_gets_its_gradient() -> None:
    points, identity, table = inputs(0, count=50)
    table.requires_grad_()
    encode(points, identity, table, layout()).sum().backward()
    assert table.grad is not None
    torch.testing.assert_close(table.grad.sum(), torch.tensor(50.0 * 5 * FEATURES))


def test_twin_against_finite_differences() -> None:
    shape = make_layout(EXTENT, coarsest=0.4, finest=0.15, levels=2, rows=64)
    generator = torch.Generator().manual_seed(0)
    points = (torch.rand(4, 3, generator=generator, dtype=torch.float64) * 0.6 + 0.01).requires_grad_()
    table = torch.randn(2, 2, 64, FEATURES, generator=generator, dtype=torch.float64, requires_grad=True)
    identity = torch.tensor([0, 1, 0, 1])
    assert torch.autograd.gradcheck(lambda p, t: reference.encode(p, identity, t, shape), (points, table))


def test_repeats_are_identical() -> None:
    points, identity, table = inputs(0)
    upstream = torch.randn(len(points), 5 * FEATURES, generator=torch.Generator().manual_seed(3))
    first, second = (gradients(points, identity, table, upstream) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    assert torch.equal(encode(points, identity, table, layout()), encode(points, identity, table, layout()))


def test_no_points() -> None:
    points, identity, table = inputs(0, count=0)
    assert encode(points, identity, table, layout()).shape == (0, 5 * FEATURES)
    assert reference.encode(points, identity, table, layout()).shape == (0, 5 * FEATURES)


def test_touched_rows_are_those_with_a_gradient() -> None:
    points, identity, table = inputs(0)
    table.requires_grad_()
    gradient = TableGradient(table)
    encode(points, identity, table, layout(), gradient).sum().backward()
    rows = gradient.buffer.reshape(-1, FEATURES).any(dim=1).numpy()
    assert (gradient.touched.astype(bool) >= rows).all()
    assert gradient.touched.mean() < 0.9

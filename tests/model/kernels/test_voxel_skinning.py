"""Inversion in voxel volumes: fast kernel against torch twin, twin against finite differences, roots against truth."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.warp import MIN_DETERMINANT, NewtonLimits, VolumeIndex, invert

CELL = 0.1
LIMITS = NewtonLimits(steps=8, tolerance=1e-6, max_step=0.05)
EXACT = NewtonLimits(steps=30, tolerance=1e-13, max_step=0.05)


def volumes() -> VolumeIndex:
    """Three poses of two volumes of different sizes; the second volume's corners share some nodes."""
    dims = np.array([[5, 6, 7], [8, 4, 5]])
    sizes = dims.prod(axis=1)
    second = np.arange(sizes[1]) // 2 * 2
    nodes = np.concatenate([np.arange(sizes[0]), second]).astype(np.int32)
    used = [0, 1, 0]
    rows = np.concatenate([[0], np.cumsum(sizes[used])])[:-1]
    return VolumeIndex(
        nodes,
        np.array([0, sizes[0]])[used],
        dims[used],
        np.array([[-0.2, 0.1, 0.0], [0.3, -0.2, -0.1]], dtype=np.float32)[used],
        rows,
        1.0 / CELL,
    )


def blended(index: VolumeIndex, seed: int, noise: float = 0.004, dtype: torch.dtype = torch.float32) -> Tensor:
    """[rows, 12] matrices near a rotation a pose, with an offset, that vary from node to node."""
    generator = torch.Generator().manual_seed(seed)
    parts = []
    for pose, size in enumerate(index.dims.prod(axis=1)):
        angle = 0.7 * pose + 0.3 * seed
        matrix = torch.tensor(
            [[np.cos(angle), -np.sin(angle), 0, 0.1], [np.sin(angle), np.cos(angle), 0, -0.2], [0, 0, 1, 0.05 * pose]],
            dtype=dtype,
        )
        parts.append(matrix.flatten() + noise * torch.randn(int(size), 12, generator=generator, dtype=dtype))
    return torch.cat(parts)


def inside(index: VolumeIndex, seed: int, count: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    """Canonical points well inside their poses' volumes, and the poses."""
    generator = torch.Generator().manual_seed(seed + 100)
    pose = torch.randint(0, len(index.dims), (count,), generator=generator, dtype=torch.int32)
    span = (torch.from_numpy(index.dims)[pose.long()] - 1) * CELL
    share = 0.1 + 0.8 * torch.rand(count, 3, generator=generator, dtype=dtype)
    return torch.from_numpy(index.origins)[pose.long()].to(dtype) + share * span.to(dtype), pose


def forward(points: Tensor, pose: Tensor, matrices: Tensor, index: VolumeIndex) -> np.ndarray:
    """f(x) by a plain loop in float64."""
    out = np.zeros((len(points), 3))
    table = matrices.detach().double().numpy()
    for m, (x, p) in enumerate(zip(points.double().numpy(), pose.tolist(), strict=True)):
        place = (x - index.origins[p]) / CELL
        lower = np.floor(place).astype(int)
        share = place - lower
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, share, 1 - share))
            at = lower + corner
            nx, ny = index.dims[p, :2]
            node = index.nodes[index.first_node[p] + at[0] + nx * (at[1] + ny * at[2])]
            out[m] += weight * (table[index.first_row[p] + node].reshape(3, 4) @ np.append(x, 1))
    return out


def problem(seed: int, count: int = 400) -> tuple[VolumeIndex, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Index, matrices, true roots, posed points, starts and poses."""
    index = volumes()
    matrices = blended(index, seed)
    roots, pose = inside(index, seed, count)
    posed = torch.from_numpy(forward(roots, pose, matrices, index)).float()
    starts = roots + 0.02 * torch.randn(count, 3, generator=torch.Generator().manual_seed(seed + 7))
    return index, matrices, roots, posed, starts, pose


@pytest.mark.parametrize("seed", range(3))
def test_roots_are_found(seed: int) -> None:
    index, matrices, roots, posed, starts, pose = problem(seed)
    found, residuals = invert(matrices, posed, starts, pose, index, LIMITS)
    assert (residuals < 1e-5).float().mean() > 0.98
    good = residuals < 1e-5
    torch.testing.assert_close(
        torch.from_numpy(forward(found[good], pose[good], matrices, index)).float(), posed[good], rtol=0, atol=2e-5
    )
    assert ((found - roots)[good].norm(dim=1) < 1e-3).float().mean() > 0.95


@pytest.mark.parametrize("seed", range(3))
def test_values_equal_the_twin(seed: int) -> None:
    index, matrices, _, posed, starts, pose = problem(seed)
    fast, fast_residual = invert(matrices, posed, starts, pose, index, LIMITS)
    slow, slow_residual = reference.invert(matrices, posed, starts, pose, index, LIMITS, MIN_DETERMINANT)
    found = (fast_residual < 1e-5) & (slow_residual < 1e-5)
    assert found.float().mean() > 0.98
    torch.testing.assert_close(fast[found], slow[found], rtol=0, atol=2e-5)


@pytest.mark.parametrize("steps", [0, 1, 2])
def test_every_iterate_equals_the_twin(steps: int) -> None:
    index, matrices, _, posed, starts, pose = problem(0)
    limits = NewtonLimits(steps=steps, tolerance=1e-6, max_step=0.01)
    fast = invert(matrices, posed, starts, pose, index, limits)
    slow = reference.invert(matrices, posed, starts, pose, index, limits, MIN_DETERMINANT)
    for a, b in zip(fast, slow, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)
    if steps == 0:
        assert torch.equal(fast[0], starts)


def test_points_outside_and_on_borders_equal_the_twin() -> None:
    index, matrices, _, _, _, _ = problem(1)
    origin, dims = torch.from_numpy(index.origins[0]), torch.from_numpy(index.dims[0])
    corners = torch.cartesian_prod(*(torch.arange(float(n)) for n in dims.tolist())) * CELL + origin
    starts = torch.cat([corners, origin - 0.3 * torch.rand(20, 3), (origin + dims * CELL + 0.2)[None]])
    pose = torch.zeros(len(starts), dtype=torch.int32)
    posed = starts + 0.05
    limits = NewtonLimits(steps=0)
    fast = invert(matrices, posed, starts, pose, index, limits)
    slow = reference.invert(matrices, posed, starts, pose, index, limits, MIN_DETERMINANT)
    for a, b in zip(fast, slow, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_gradients_equal_the_twin(seed: int) -> None:
    index, matrices, _, posed, starts, pose = problem(seed)
    upstream = torch.randn(len(posed), 3, generator=torch.Generator().manual_seed(seed))
    # Only roots on which both agree: in a cell where two lie close, the last bits choose.
    with torch.no_grad():
        found = invert(matrices, posed, starts, pose, index, LIMITS)[1] < 1e-5
    posed, starts, pose, upstream = posed[found], starts[found], pose[found], upstream[found]
    fast, slow = matrices.clone().requires_grad_(), matrices.clone().requires_grad_()
    invert(fast, posed, starts, pose, index, LIMITS)[0].backward(upstream)
    reference.invert(slow, posed, starts, pose, index, LIMITS, MIN_DETERMINANT)[0].backward(upstream)
    assert fast.grad is not None and slow.grad is not None
    torch.testing.assert_close(fast.grad, slow.grad, rtol=1e-3, atol=1e-3)


def test_twin_against_finite_differences() -> None:
    index = volumes()
    matrices = blended(index, 0, noise=0.002, dtype=torch.float64)
    roots, pose = inside(index, 0, 3, dtype=torch.float64)
    posed = torch.from_numpy(forward(roots, pose, matrices, index))
    used = matrices.clone().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda m: reference.invert(m, posed, roots, pose, index, EXACT, MIN_DETERMINANT)[0],
        (used,),
        eps=1e-7,
        atol=1e-5,
        fast_mode=True,
    )


def test_singular_roots_give_no_gradient() -> None:
    index = volumes()
    flat = torch.zeros(len(blended(index, 0)), 12)
    flat[:, 0] = flat[:, 5] = 1.0  # z is lost
    points, pose = inside(index, 0, 10)
    posed = points * torch.tensor([1.0, 1.0, 0.0])
    for function in (
        lambda m: invert(m, posed, points, pose, index, LIMITS),
        lambda m: reference.invert(m, posed, points, pose, index, LIMITS, MIN_DETERMINANT),
    ):
        leaf = flat.clone().requires_grad_()
        roots, residuals = function(leaf)
        roots.sum().backward()
        assert leaf.grad is not None and not leaf.grad.any()
        assert torch.isfinite(roots).all() and (residuals < 1e-5).all()


def test_repeats_are_identical() -> None:
    index, matrices, _, posed, starts, pose = problem(2)
    results = []
    for _ in range(2):
        leaf = matrices.clone().requires_grad_()
        roots, residuals = invert(leaf, posed, starts, pose, index, LIMITS)
        roots.square().sum().backward()
        results.append((roots.detach(), residuals, leaf.grad))
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


def test_no_points() -> None:
    index, matrices, _, posed, starts, pose = problem(0, count=1)
    for found in (
        invert(matrices, posed[:0], starts[:0], pose[:0], index, LIMITS),
        reference.invert(matrices, posed[:0], starts[:0], pose[:0], index, LIMITS, MIN_DETERMINANT),
    ):
        assert found[0].shape == (0, 3) and found[1].shape == (0,)

"""Volume integration over packed candidates: fast kernel, torch twin, a plain loop and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.volume import integrate

Candidates = tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]


def random_candidates(seed: int, rays: int = 200, dtype: torch.dtype = torch.float32) -> Candidates:
    """Density, rgb, first, depth, delta, is_object: rays of 0 to 12 candidates, a third of them at equal depths."""
    generator = np.random.default_rng(seed)
    counts = generator.integers(0, 13, rays)
    counts[:3] = (0, 1, 12)
    first = np.concatenate([[0], np.cumsum(counts)])
    total = int(first[-1])
    depth = np.concatenate([np.sort(generator.integers(1, 12, n)) * 0.1 for n in counts])
    density = generator.random(total) * 20.0
    density[generator.random(total) < 0.2] = 0.0
    arrays = density, generator.random((total, 3)), depth, generator.uniform(0.05, 0.15, total)
    density, rgb, depth, delta = (torch.from_numpy(a).to(dtype) for a in arrays)
    return density, rgb, torch.from_numpy(first), depth, delta, torch.from_numpy(generator.random(total) < 0.4)


def by_loop(candidates: Candidates, stop: float) -> tuple[np.ndarray, np.ndarray]:
    """The definition, candidate by candidate in float64."""
    density, rgb, first, depth, delta, is_object = (c.numpy() for c in candidates)
    out, weights = np.zeros((len(first) - 1, 6)), np.zeros(len(density))
    for ray in range(len(out)):
        light = 1.0
        span = slice(first[ray], first[ray + 1])
        for at in np.unique(depth[span]):
            same = first[ray] + np.flatnonzero(depth[span] == at)
            chosen = same[np.argmax(density[same])]
            if light < stop:
                break
            alpha = 1.0 - np.exp(-float(density[chosen]) * float(delta[chosen]))
            weights[chosen] = light * alpha
            light *= 1.0 - alpha
            out[ray] += weights[chosen] * np.array([*rgb[chosen], 1.0, at, is_object[chosen]])
    return out, weights


def gradients(function: object, candidates: Candidates, stop: float, upstream: Tensor) -> tuple[Tensor, Tensor]:
    """Gradients to density and colour."""
    density, rgb = (c.clone().requires_grad_() for c in candidates[:2])
    function(density, rgb, *candidates[2:], stop)[0].backward(upstream)  # type: ignore[operator]
    assert density.grad is not None and rgb.grad is not None
    return density.grad, rgb.grad


@pytest.mark.parametrize("stop", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(3))
def test_values_equal_the_definition(seed: int, stop: float) -> None:
    candidates = random_candidates(seed)
    expected = by_loop(candidates, stop)
    for function in (integrate, reference.integrate):
        for found, value in zip(function(*candidates, stop), expected, strict=True):
            np.testing.assert_allclose(found.numpy(), value, rtol=1e-4, atol=2e-6)


@pytest.mark.parametrize("stop", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(3))
def test_gradients_equal_the_twin(seed: int, stop: float) -> None:
    candidates = random_candidates(seed)
    upstream = torch.randn(200, 6, generator=torch.Generator().manual_seed(seed))
    fast = gradients(integrate, candidates, stop, upstream)
    slow = gradients(reference.integrate, candidates, stop, upstream)
    for a, b in zip(fast, slow, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6)


def test_twin_against_finite_differences() -> None:
    density, rgb, *rest = random_candidates(5, rays=8, dtype=torch.float64)
    density = density + 0.5 + torch.arange(len(density)) * 0.01  # differences must not change which one is densest
    assert torch.autograd.gradcheck(
        lambda d, c: reference.integrate(d, c, *rest, 0.0)[0], (density.requires_grad_(), rgb.requires_grad_())
    )


def one_ray(density: list[float], depth: list[float]) -> Candidates:
    """One white ray, steps of 0.1 m, nothing on objects."""
    count = len(density)
    return (
        torch.tensor(density),
        torch.ones(count, 3),
        torch.tensor([0, count]),
        torch.tensor(depth),
        torch.full((count,), 0.1),
        torch.zeros(count, dtype=torch.bool),
    )


@pytest.mark.parametrize("function", [integrate, reference.integrate])
class TestSpecialRays:
    """Rays whose result is known by hand."""

    def test_all_merged(self, function: object) -> None:
        candidates = one_ray([1.0, 7.0, 3.0], [2.0, 2.0, 2.0])
        out, weights = function(*candidates, 0.0)  # type: ignore[operator]
        alpha = 1.0 - np.exp(-0.7)
        np.testing.assert_allclose(weights, [0.0, alpha, 0.0], rtol=1e-6)
        np.testing.assert_allclose(out[0], [alpha, alpha, alpha, alpha, 2.0 * alpha, 0.0], rtol=1e-6)
        gradient, colour = gradients(function, candidates, 0.0, torch.ones(1, 6))
        assert gradient[0] == 0 and gradient[2] == 0 and gradient[1] > 0
        assert not colour[[0, 2]].any()

    def test_equal_densities_choose_the_first(self, function: object) -> None:
        weights = function(*one_ray([5.0, 5.0], [1.0, 1.0]), 0.0)[1]  # type: ignore[operator]
        assert weights[0] > 0 and weights[1] == 0

    def test_single_candidate(self, function: object) -> None:
        out, _ = function(*one_ray([4.0], [3.0]), 0.0)  # type: ignore[operator]
        np.testing.assert_allclose(out[0, 3], 1.0 - np.exp(-0.4), rtol=1e-6)

    def test_zero_densities_have_gradients(self, function: object) -> None:
        candidates = one_ray([0.0, 0.0], [1.0, 2.0])
        out, weights = function(*candidates, 0.0)  # type: ignore[operator]
        assert not out.any() and not weights.any()
        gradient, _ = gradients(function, candidates, 0.0, torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]]))
        np.testing.assert_allclose(gradient, [0.1, 0.1], rtol=1e-6)

    def test_nothing_behind_the_stop(self, function: object) -> None:
        candidates = one_ray([50.0, 9.0, 0.0], [1.0, 2.0, 3.0])
        _, weights = function(*candidates, 0.1)  # type: ignore[operator]
        assert weights[0] > 0.99 and not weights[1:].any()
        gradient, colour = gradients(function, candidates, 0.1, torch.ones(1, 6))
        assert gradient[0] > 0 and not gradient[1:].any() and not colour[1:].any()

    def test_opaque(self, function: object) -> None:
        candidates = one_ray([1e30, 5.0], [1.0, 2.0])
        out, weights = function(*candidates, 0.0)  # type: ignore[operator]
        np.testing.assert_array_equal(weights, [1.0, 0.0])
        assert out[0, 3] == 1.0
        assert all(torch.isfinite(g).all() for g in gradients(function, candidates, 0.0, torch.ones(1, 6)))

    def test_empty(self, function: object) -> None:
        density, rgb, _, *rest = one_ray([], [])
        out, weights = function(density, rgb, torch.zeros(4, dtype=torch.int64), *rest, 0.0)  # type: ignore[operator]
        assert out.shape == (3, 6) and not out.any() and weights.shape == (0,)
        out, _ = function(density, rgb, torch.zeros(1, dtype=torch.int64), *rest, 0.0)  # type: ignore[operator]
        assert out.shape == (0, 6)


def test_repeats_are_identical() -> None:
    candidates = random_candidates(9)
    upstream = torch.ones(200, 6)
    for function in (integrate, reference.integrate):
        first, second = (
            (*function(*candidates, 0.01), *gradients(function, candidates, 0.01, upstream)) for _ in range(2)
        )
        assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))

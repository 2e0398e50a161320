"""Volume integration against closed forms."""

from __future__ import annotations

import math

import pytest
import torch

from chona_model.render.integration import EMPTY_DEPTH, integrate, ray_weights, visible_confidence
from chona_model.render.sampling import stratified_edges


def test_the_documented_example() -> None:
    light = ray_weights(torch.tensor([[0.0, 2.0, 0.0]]), torch.full((1, 3), 0.5))
    torch.testing.assert_close(light.weights, torch.tensor([[0.0, 1 - math.exp(-1), 0.0]]))
    torch.testing.assert_close(light.remaining, torch.tensor([math.exp(-1)]))


def test_a_slab_of_constant_density() -> None:
    """α = 1 - exp(-σ L); mean depth of the light that stops: near + 1/σ - L exp(-σL) / (1 - exp(-σL))."""
    near, length, sigma, count = 2.0, 1.5, 0.8, 4000
    edges = stratified_edges(torch.tensor([near]).double(), torch.tensor([near + length]).double(), count)
    light = ray_weights(torch.full((1, count), sigma, dtype=torch.float64), edges[:, 1:] - edges[:, :-1])
    middle = 0.5 * (edges[:, 1:] + edges[:, :-1])
    colour = torch.tensor([0.2, 0.4, 0.6]).double().expand(1, count, 3)
    shares = torch.tensor([0.75, 0.25]).double().expand(1, count, 2)
    pixel = integrate(light.weights, colour, middle, shares)
    alpha = 1 - math.exp(-sigma * length)
    depth = near + 1 / sigma - length * math.exp(-sigma * length) / alpha
    torch.testing.assert_close(pixel.alpha, torch.tensor([alpha], dtype=torch.float64))
    torch.testing.assert_close(pixel.depth, torch.tensor([depth], dtype=torch.float64), rtol=0, atol=1e-6)
    torch.testing.assert_close(pixel.rgb, alpha * torch.tensor([[0.2, 0.4, 0.6]]).double())
    torch.testing.assert_close(pixel.mattes, alpha * torch.tensor([[0.75, 0.25]]).double())


def test_a_spike_gives_a_one_hot_weight_and_its_depth() -> None:
    density = torch.zeros(1, 64)
    density[0, 17] = 1e10
    light = ray_weights(density, torch.full((1, 64), 0.1))
    expected = torch.zeros(1, 64)
    expected[0, 17] = 1.0
    torch.testing.assert_close(light.weights, expected, rtol=0, atol=0)
    pixel = integrate(light.weights, torch.rand(1, 64, 3), torch.arange(64.0)[None], torch.zeros(1, 64, 2))
    assert float(pixel.depth) == 17.0


def test_an_empty_ray_has_the_empty_depth_and_gradients() -> None:
    density = torch.zeros(1, 8, requires_grad=True)
    light = ray_weights(density, torch.ones(1, 8))
    pixel = integrate(light.weights, torch.rand(1, 8, 3), torch.arange(8.0)[None], torch.zeros(1, 8, 2))
    assert float(pixel.depth.detach()) == EMPTY_DEPTH
    (pixel.depth + pixel.alpha + pixel.rgb.sum()).sum().backward()
    assert density.grad is not None and torch.isfinite(density.grad).all() and (density.grad > 0).all()


def test_colours_are_premultiplied_and_order_matters() -> None:
    light = ray_weights(torch.tensor([[1.0, 3.0]]), torch.ones(1, 2))
    colours = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    pixel = integrate(light.weights, colours, torch.tensor([[1.0, 2.0]]), torch.zeros(1, 2, 2))
    red, green = 1 - math.exp(-1), math.exp(-1) * (1 - math.exp(-3))
    torch.testing.assert_close(pixel.rgb, torch.tensor([[red, green, 0.0]]))


def test_confidence_counts_failures_that_would_be_seen() -> None:
    density = torch.tensor([[0.0, 0.0, 50.0, 0.0, 50.0, 0.0]])
    light = ray_weights(density, torch.full((1, 6), 0.5))

    def confidence(*failed: int) -> float:
        converged = torch.ones(1, 6, dtype=torch.bool)
        converged[0, list(failed)] = False
        return float(visible_confidence(light, converged))

    assert confidence() == 1.0
    assert confidence(5) == pytest.approx(1.0)  # behind an opaque surface
    assert confidence(0) == 1.0  # in empty air
    assert confidence(1) == pytest.approx(0.5)  # right before the surface: may have been surface
    empty = ray_weights(torch.zeros(1, 4), torch.ones(1, 4))
    assert float(visible_confidence(empty, torch.tensor([[True, False, True, True]]))) == 0.75


def test_jittered_edges_increase_stay_inside_and_repeat() -> None:
    near, far = torch.tensor([1.0, 2.0, 5.0]), torch.tensor([3.0, 2.0, 4.0])
    first, second = (stratified_edges(near, far, 16, torch.Generator().manual_seed(3)) for _ in range(2))
    torch.testing.assert_close(first, second, rtol=0, atol=0)
    assert (first[0].diff() > 0).all() and float(first[0, 0]) == 1.0 and float(first[0, -1]) == 3.0
    assert (first[1:].diff() == 0).all()
    assert not torch.equal(first, stratified_edges(near, far, 16, torch.Generator().manual_seed(4)))
    with pytest.raises(ValueError, match="at least one sample"):
        stratified_edges(near, far, 0)

"""Properties that hold for every input: integration, geometry, encodings, perceptrons; kernels beside their twins."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from chona_model.field.encodings import integrated_encoding
from chona_model.geometry import inverse_3x3, ray_box, segment_distances
from chona_model.kernels import reference
from chona_model.kernels.grid import FEATURES, TableGradient, encode, make_layout
from chona_model.kernels.perceptron import FieldWeights, evaluate
from chona_model.kernels.volume import integrate
from chona_model.render.frustum import conical_frusta
from chona_model.render.integration import ray_weights

FEW = settings(max_examples=40, derandomize=True)

magnitudes = st.one_of(st.just(0.0), st.floats(-30, 30).map(lambda e: float(np.float32(10.0**e))))
"""0, and 1e-30 … 1e30, evenly over the exponents."""


def reals(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, width=32)


def finite(*tensors: torch.Tensor | None) -> bool:
    return all(tensor is not None and bool(torch.isfinite(tensor).all()) for tensor in tensors)


@st.composite
def rays(draw: st.DrawFn) -> tuple[torch.Tensor, ...]:
    """Three rays of up to 40 candidates: density, rgb, first, depth, delta, is_object; optical depths up to 1e30."""
    counts = draw(st.lists(st.integers(0, 40), min_size=3, max_size=3))
    total, seed = sum(counts), draw(st.integers(0, 2**31))
    generator = torch.Generator().manual_seed(seed)
    delta = draw(st.sampled_from([1e-6, 0.01, 1.0, 1e6]))
    scale = draw(magnitudes) / delta
    spikes = torch.rand(total, generator=generator) < draw(reals(0, 1))
    density = scale * torch.rand(total, generator=generator) * spikes
    depth = torch.cumsum(torch.rand(total, generator=generator).round() * 0.01 + 1e-3 * (seed % 2), dim=0)
    first = torch.tensor([0, *np.cumsum(counts)])
    colours = torch.rand(total, 3, generator=generator)
    return density, colours, first, depth, torch.full((total,), delta), torch.rand(total, generator=generator) > 0.5


@FEW
@given(rays())
def test_weights_and_transmittance_sum_to_one(candidates: tuple[torch.Tensor, ...]) -> None:
    """In float32 within 1e-6, kernel and twin within 1e-5 of each other's weights, gradients finite."""
    density, rgb, first, depth, delta, is_object = candidates
    results = {}
    for name, function in (("kernel", integrate), ("twin", reference.integrate)):
        sigma, colours = density.clone().requires_grad_(), rgb.clone().requires_grad_()
        out, weights = function(sigma, colours, first, depth, delta, is_object, 0.0)
        (out * torch.linspace(-1, 1, 6)).sum().backward()
        assert finite(out, weights, sigma.grad, colours.grad), name
        assert (weights >= 0).all() and (out[:, 3] <= 1 + 1e-6).all() and (out[:, 5] <= out[:, 3] + 1e-6).all()
        results[name] = weights
        for ray in range(3):
            own = slice(int(first[ray]), int(first[ray + 1]))
            chosen = weights[own] > 0
            passed = torch.exp(-(density[own].double() * delta[own].double())[chosen].sum())
            assert abs(float(weights[own].double().sum() + passed) - 1.0) < 1e-6, name
    torch.testing.assert_close(results["kernel"], results["twin"], rtol=0, atol=1e-5)


@FEW
@given(st.integers(0, 30), st.floats(8, 30), st.integers(1, 31))
def test_a_spike_takes_all_the_weight(place: int, exponent: float, count: int) -> None:
    """One density of 1e8/m and more among empty ones: its weight is 1 exactly, the others' 0."""
    place = place % count
    density = torch.zeros(count)
    density[place] = 10.0**exponent
    depth = 1.0 + 0.01 * torch.arange(count)
    given_rays = (torch.ones(count, 3), torch.tensor([0, count]), depth, torch.full((count,), 0.01))
    for function in (integrate, reference.integrate):
        out, weights = function(density, *given_rays, torch.zeros(count, dtype=torch.bool), 0.0)
        expected = torch.zeros(count)
        expected[place] = 1.0
        assert torch.equal(weights, expected)
        assert float(out[0, 4]) == float(depth[place])
    light = ray_weights(density[None], torch.full((1, count), 0.01))
    assert torch.equal(light.weights[0], expected) and float(light.remaining) == 0.0


@FEW
@given(arrays(np.float32, (20,), elements=magnitudes), magnitudes)
def test_ray_weights_sum_to_one_in_every_magnitude(density: np.ndarray, length: float) -> None:
    sigma = torch.from_numpy(density.copy()).requires_grad_()
    light = ray_weights(sigma[None], torch.full((1, 20), length))
    assert abs(float((light.weights.sum() + light.remaining).detach()) - 1.0) < 1e-6
    (light.weights * torch.arange(20)).sum().backward()
    if length * float(density.max()) <= 1e30:
        assert finite(sigma.grad)


LAYOUT = make_layout(np.array([0.9, 1.1, 0.7]), coarsest=0.2, finest=0.012, levels=5, rows=1024)
TABLE = torch.randn(2, 5, 1024, FEATURES, generator=torch.Generator().manual_seed(0))


@FEW
@given(arrays(np.float32, (12, 3), elements=st.one_of(reals(-0.5, 1.5), reals(-(2.0**127), 2.0**127), magnitudes)))
def test_encodings_of_points_anywhere(points: np.ndarray) -> None:
    """Points outside the box count as on its border: finite, bounded by the table, kernel = twin, gradients too."""
    identity = torch.arange(12, dtype=torch.int32) % 2
    results = []
    for gradient in (TableGradient(TABLE), None):
        x, table = torch.from_numpy(points.copy()).requires_grad_(), TABLE.clone().requires_grad_()
        found = encode(x, identity, table, LAYOUT, gradient)
        found.square().sum().backward()
        assert finite(found, x.grad) and (found.abs() <= TABLE.abs().max() * (1 + 1e-5)).all()
        results.append((found.detach(), x.grad))
    torch.testing.assert_close(results[0][0], results[1][0], rtol=1e-4, atol=1e-4)
    inside = torch.from_numpy(((points > 0.01) & (points < 0.69)).all(axis=1))
    torch.testing.assert_close(results[0][1][inside], results[1][1][inside], rtol=1e-3, atol=0.5)
    double = encode(torch.from_numpy(points).double(), identity, TABLE.double(), LAYOUT)
    assert (results[0][0] - double).abs().max() < 1e-2  # the finest cells' share of a coordinate rounded to float32


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_encodings_of_what_is_no_point(bad: float) -> None:
    """NaN comes out as NaN, infinities count as on the border; no memory outside the table is read, others stay."""
    points = torch.full((9, 3), 0.3)
    points[4, 1] = bad
    identity = torch.zeros(9, dtype=torch.int32)
    for x in (points, points.double()):
        found = encode(x, identity, TABLE.to(x.dtype), LAYOUT)
        others = torch.arange(9) != 4
        assert finite(found[others]) and (found[others] == found[0]).all()
        assert torch.isnan(found[4]).all() if np.isnan(bad) else torch.isfinite(found[4]).all()


def perceptrons(scale: float, dtype: torch.dtype) -> FieldWeights:
    """Random weights with last layers so large that logits reach ±1e4 and beyond."""
    generator = torch.Generator().manual_seed(0)

    def made(*size: int, times: float = 1.0) -> torch.Tensor:
        return (times * torch.randn(*size, generator=generator)).to(dtype)

    return FieldWeights(
        made(32, 16), made(1, 32), made(16, 32, times=scale), made(16), made(32, 31, times=0.3), made(1, 32),
        made(3, 32, times=scale), made(3), made(32, 15, times=0.3), made(1, 32), made(1, 32, times=scale), made(1),
    )  # fmt: skip


@pytest.mark.parametrize("scale", [1.0, 1e2, 1e4])
def test_perceptrons_of_enormous_logits(scale: float) -> None:
    """Kernel and float32 twin against float64, relative to density; sigmoids saturate, gradients stay finite."""
    encoded = torch.randn(100, 16, generator=torch.Generator().manual_seed(1))
    rows = torch.zeros(100, dtype=torch.int64)
    exact_density, exact_rgb = evaluate(encoded.double(), perceptrons(scale, torch.float64), rows, rows, 25.0)
    assert exact_density.max() / 25.0 > scale
    for dtype in (torch.float32, torch.bfloat16):
        weights = FieldWeights(
            *(None if t is None else t.requires_grad_() for t in perceptrons(scale, dtype).tensors())
        )
        x = encoded.clone().to(dtype).requires_grad_()
        density, rgb = evaluate(x, weights, rows, rows, 25.0)
        ((density / scale).sum() + rgb.sum()).backward()
        assert finite(density, rgb, x.grad, *(t.grad for t in weights.tensors() if t is not None))
        assert (density >= 0).all() and ((rgb >= 0) & (rgb <= 1)).all()
        if dtype == torch.float32:
            assert ((density - exact_density).abs() / (25.0 * scale)).max() < 1e-4
            settled = (exact_rgb - exact_rgb.round()).abs() < 1e-6
            assert (rgb - exact_rgb)[settled].abs().max() < 1e-3


@FEW
@given(arrays(np.float64, (3, 3), elements=st.floats(-1, 1)), st.floats(-12, 12))
def test_inverses_at_every_scale(matrix: np.ndarray, exponent: float) -> None:
    """Regular ones are inverses, the others bounded; scaling the matrix scales the inverse."""
    scaled = torch.from_numpy(matrix * 10.0**exponent)
    for dtype in (torch.float32, torch.float64):
        result = inverse_3x3(scaled.to(dtype)[None])
        assert finite(result.matrix)
        if bool(result.regular) and dtype == torch.float64:
            torch.testing.assert_close(result.matrix[0] @ scaled, torch.eye(3).double(), rtol=0, atol=1e-8)
        size = float(scaled.norm()) / 3**0.5
        assert float(torch.linalg.matrix_norm(result.matrix[0].double(), ord=2)) * size <= 3.1e4


@FEW
@given(arrays(np.float32, (4, 3), elements=reals(-1e6, 1e6)), arrays(np.float32, (2, 3), elements=reals(-10, 10)))
def test_distances_to_bones_of_any_length(points: np.ndarray, ends: np.ndarray) -> None:
    x = torch.from_numpy(points.copy()).requires_grad_()
    head, tail = torch.from_numpy(ends)
    distance = segment_distances(x, head, tail)
    distance.sum().backward()
    assert finite(distance, x.grad) and (distance >= 0).all() and (x.grad.norm(dim=-1) <= 1 + 1e-5).all()
    exact = segment_distances(torch.from_numpy(points).double(), head.double(), tail.double())
    assert ((distance - exact).abs() <= 1e-5 * (1 + exact + head.norm() + tail.norm())).all()


@FEW
@given(arrays(np.float32, (3,), elements=reals(-3, 3)), arrays(np.float32, (3,), elements=reals(-1, 1)))
def test_rays_enter_and_leave_boxes_on_their_faces(origin: np.ndarray, direction: np.ndarray) -> None:
    start, along = torch.from_numpy(origin).double(), torch.from_numpy(direction).double()
    near, far, hit = ray_box(start, along, -torch.ones(3).double(), torch.ones(3).double())
    assert float(near) >= 0 and float(far) >= float(near)
    if bool(hit) and np.isfinite(float(far)):
        middle = start + 0.5 * (near + far) * along
        assert (middle.abs() <= 1 + 1e-6 * (1 + float(far))).all()


@FEW
@given(st.floats(0, 18), st.floats(-6, 0), st.integers(0, 2**31))
def test_frusta_from_the_tip_to_the_sky(exponent: float, radius: float, seed: int) -> None:
    """Means lie within their interval and covariances are positive, in float32 as in float64 (relative 1e-4)."""
    edges = torch.sort(torch.rand(1, 9, generator=torch.Generator().manual_seed(seed)), dim=1).values * 10.0**exponent
    edges[0, 0] = 0.0
    directions, radii = torch.tensor([[0.3, -0.4, 1.0]]), torch.tensor([10.0**radius])
    single = conical_frusta(torch.zeros(1, 3), directions, radii, edges)
    double = conical_frusta(torch.zeros(1, 3).double(), directions.double(), radii.double(), edges.double())
    for one, other in zip(single, double, strict=True):
        assert finite(one)
        torch.testing.assert_close(one.double(), other, rtol=1e-4, atol=1e-4 * float(other.abs().max()))
    assert (single[0] >= edges[:, :-1]).all() and (single[0] <= edges[:, 1:] * (1 + 1e-6)).all()
    assert (torch.diagonal(single[2], dim1=-2, dim2=-1) >= 0).all()


@FEW
@given(arrays(np.float32, (5, 3), elements=reals(-4, 4)), arrays(np.float32, (5, 3), elements=magnitudes))
def test_integrated_encodings_shrink_with_variance(mean: np.ndarray, variance: np.ndarray) -> None:
    """|E[sin]| ≤ exp(−4^k σ² / 2), within float32 of float64, for variances 0 … 1e30."""
    x, spread = torch.from_numpy(mean.copy()).requires_grad_(), torch.from_numpy(variance.copy()).requires_grad_()
    found = integrated_encoding(x, spread, 8)
    found.square().sum().backward()
    exact = integrated_encoding(x.detach().double(), spread.detach().double(), 8)
    assert finite(found, x.grad, spread.grad) and (found.abs() <= 1).all()
    # A coordinate's rounding, 2^-22 at 4, times the highest frequency.
    assert (found - exact).abs().max() < 2.0**7 * 2.0**-22

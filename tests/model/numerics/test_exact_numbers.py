"""Values and gradients of the exact path's parts at the ends of their ranges."""

from __future__ import annotations

import pytest
import torch

from chona_model.deform.skinning import softmax_weights
from chona_model.field.encodings import integrated_encoding
from chona_model.geometry import inverse_3x3, ray_box, safe_norm, segment_distances
from chona_model.render.frustum import conical_frusta, cylinders
from chona_model.render.integration import integrate, ray_weights

MAGNITUDES = (0.0, 1e-30, 1e-10, 1.0, 1e10, 1e30)
DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


def finite(*tensors: torch.Tensor | None) -> bool:
    return all(tensor is not None and bool(torch.isfinite(tensor).all()) for tensor in tensors)


@pytest.mark.parametrize("length", MAGNITUDES)
@pytest.mark.parametrize("density", MAGNITUDES)
def test_integration_of_any_density_over_any_length(density: float, length: float) -> None:
    generator = torch.Generator().manual_seed(0)
    sigma = (density * torch.rand(4, 64, generator=generator)).requires_grad_()
    lengths = length * torch.rand(4, 64, generator=generator)
    depths = torch.cumsum(lengths.clamp(max=1e25), dim=-1)
    light = ray_weights(sigma, lengths)
    total = light.weights.sum(dim=-1) + light.remaining
    torch.testing.assert_close(total, torch.ones(4), rtol=0, atol=1e-6)
    pixel = integrate(light.weights, torch.rand(4, 64, 3), depths, torch.rand(4, 64, 2))
    assert finite(pixel.rgb, pixel.alpha, pixel.depth, pixel.mattes)
    (pixel.rgb.sum() + pixel.alpha.sum() + pixel.mattes.sum()).backward()
    if density * length <= 1e30:
        assert finite(sigma.grad)


@pytest.mark.parametrize("dtype", DTYPES)
def test_integration_in_every_precision(dtype: torch.dtype) -> None:
    """Stated bound against float64: 8 units of rounding of the input's precision, 1e-6 at best in float32."""
    generator = torch.Generator().manual_seed(1)
    density = (30 * torch.rand(8, 64, generator=generator)).to(dtype)
    lengths = torch.full((8, 64), 0.0625, dtype=dtype)
    light = ray_weights(density.requires_grad_(), lengths)
    exact = ray_weights(density.detach().double(), lengths.double())
    bound = 1e-6 if dtype != torch.float64 else 1e-14
    torch.testing.assert_close(light.weights.double(), exact.weights, rtol=0, atol=bound)
    light.weights.square().sum().backward()
    assert finite(density.grad)


@pytest.mark.parametrize("dtype", DTYPES)
def test_skinning_weights_of_enormous_logits(dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(0)
    logits = (1e4 * (2 * torch.rand(50, 26, generator=generator) - 1)).to(dtype)
    logits[0], logits[1] = 1e4, -1e4
    logits[2] = 0
    logits[2, 3], logits[2, 4] = 1e4, -1e4
    present = torch.rand(50, 25, generator=generator) > 0.5
    present[3] = False
    logits.requires_grad_()
    weights = softmax_weights(logits, present)
    assert weights.dtype in {torch.float32, torch.float64}
    torch.testing.assert_close(weights.sum(dim=-1), torch.ones(50).to(weights), rtol=0, atol=1e-6)
    assert (weights[:, :25][~present] == 0).all() and float(weights[3, 25].detach()) == 1.0
    weights.square().sum().backward()
    assert finite(logits.grad)


@pytest.mark.parametrize("scale", (0.0, 1e-30, 1e-6, 1.0, 1e6, 1e18))
@pytest.mark.parametrize("shape", [conical_frusta, cylinders])
def test_frusta_at_any_depth(shape: type[conical_frusta], scale: float) -> None:
    edges = scale * torch.tensor([[0.0, 0.0, 1e-6, 0.5, 0.5000001, 1.0]])
    directions = torch.tensor([[0.3, -0.4, 1.0]], requires_grad=True)
    radii = torch.tensor([1e-3], requires_grad=True)
    depths, means, covariances = shape(torch.zeros(1, 3), directions, radii, edges)
    assert finite(depths, means, covariances)
    assert (depths >= edges[:, :-1]).all() and (depths <= edges[:, 1:] * (1 + 1e-6)).all()
    assert (torch.diagonal(covariances, dim1=-2, dim2=-1) >= 0).all()
    (means.mean() + covariances.mean()).backward()
    assert finite(directions.grad, radii.grad)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("variance", (0.0, 1e-30, 1.0, 6e4, 1e30))
def test_integrated_encoding_of_any_variance(variance: float, dtype: torch.dtype) -> None:
    if variance > torch.finfo(dtype).max:
        pytest.skip("not a number of this precision")
    mean = torch.tensor([[0.0, 1.0, -1e3], [1e-30, 3.0, 50.0]], dtype=dtype, requires_grad=True)
    spread = torch.full((2, 3), variance, dtype=dtype, requires_grad=True)
    # In float16 the true slope by the variance, -4^k / 2, leaves the format's range beyond 8 octaves.
    features = integrated_encoding(mean, spread, 8 if dtype == torch.float16 else 10)
    assert features.dtype == dtype and finite(features) and (features.abs() <= 1).all()
    if variance >= 6e4:
        assert (features == 0).all()
    features.float().square().sum().backward()
    assert finite(mean.grad, spread.grad)


def test_integrated_encoding_is_even_in_rounding_noise() -> None:
    """A warped covariance may leave a variance of -1e-12: it counts as 0."""
    mean = torch.rand(5, 3)
    torch.testing.assert_close(
        integrated_encoding(mean, torch.full((5, 3), -1e-12), 8), integrated_encoding(mean, torch.zeros(5, 3), 8)
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", (1e-15, 1.0, 1e15))
def test_singular_matrices_are_flagged_and_bounded(scale: float, dtype: torch.dtype) -> None:
    outer = torch.tensor([1.0, 2.0, 3.0], dtype=dtype)
    half_turn = 0.5 * torch.eye(3, dtype=dtype) + 0.5 * torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=dtype))
    matrices = scale * torch.stack(
        [
            torch.zeros(3, 3, dtype=dtype),
            outer[:, None] * outer,
            half_turn,  # opposed bones at equal weight: rank 1
            torch.diag(torch.tensor([1.0, 1.0, 0.0], dtype=dtype)),
            torch.diag(torch.tensor([1.0, 1.0, 1e-6], dtype=dtype)),
        ]
    )
    result = inverse_3x3(matrices)
    assert not result.regular.any() and finite(result.matrix)
    # (MᵀM + λ²)⁻¹ Mᵀ has no singular value above 1 / (2 λ).
    norms = (matrices.square().sum(dim=(-2, -1)) / 3).sqrt()
    largest = torch.linalg.matrix_norm(result.matrix, ord=2)
    assert (largest[1:] * norms[1:] <= 51).all()
    assert (result.matrix[0] == 0).all()


@pytest.mark.parametrize("bad", (float("nan"), float("inf")))
def test_matrices_that_are_not_finite_are_flagged_and_zero(bad: float) -> None:
    matrices = torch.eye(3).repeat(2, 1, 1)
    matrices[0, 1, 2] = bad
    result = inverse_3x3(matrices)
    assert result.regular.tolist() == [False, True] and (result.matrix[0] == 0).all()
    torch.testing.assert_close(result.matrix[1], torch.eye(3))


@pytest.mark.parametrize("scale", (1e-30, 1e-18, 1.0, 1e18, 1e30))
def test_lengths_at_every_magnitude(scale: float) -> None:
    vectors = (scale * torch.tensor([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])).requires_grad_()
    lengths = safe_norm(vectors)
    torch.testing.assert_close(lengths / scale, torch.tensor([5.0, 0.0]))
    lengths.sum().backward()
    torch.testing.assert_close(vectors.grad, torch.tensor([[0.6, 0.8, 0.0], [0.0, 0.0, 0.0]]))


@pytest.mark.parametrize("length", (0.0, 1e-30, 1e-20, 1e-6))
def test_bones_of_almost_no_length(length: float) -> None:
    points = torch.tensor([[0.0, 2.0, 0.0], [length, 0.0, 0.0], [-1.0, 0.0, 0.0]], requires_grad=True)
    distances = segment_distances(points, torch.zeros(3), torch.tensor([length, 0.0, 0.0]))
    torch.testing.assert_close(distances, torch.tensor([2.0, 0.0, 1.0]), rtol=1e-6, atol=1e-6)
    distances.sum().backward()
    assert finite(points.grad)


def test_rays_in_slab_planes_over_all_axes() -> None:
    """Every ray along an axis through a corner, an edge or a face of the unit cube hits it, without a NaN."""
    for axis in range(3):
        others = torch.cartesian_prod(torch.tensor([0.0, 0.5, 1.0]), torch.tensor([0.0, 0.5, 1.0]))
        origins = torch.zeros(9, 3)
        origins[:, [other for other in range(3) if other != axis]] = others
        origins[:, axis] = -2.0
        for sign in (0.0, -0.0):
            directions = torch.full((9, 3), sign)
            directions[:, axis] = 1.0
            near, far, hit = ray_box(origins, directions, torch.zeros(3), torch.ones(3))
            assert hit.all() and (near == 2).all() and (far == 3).all()

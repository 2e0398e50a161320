"""The conditional radiance field."""

from __future__ import annotations

import torch

from chona_model.field.radiance import FieldShape, RadianceField

SHAPE = FieldShape(degrees=4, width=24, depth=6, head_width=12)


def field(condition: int = 5, pose: int = 7) -> RadianceField:
    torch.manual_seed(0)
    return RadianceField(SHAPE, condition, pose, (0.1, 0.2, 0.3), 2.0).double()


def query(model: RadianceField, **changes: torch.Tensor | None) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)

    def draw(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    arguments = {"means": draw(9, 3), "covariances": 1e-3 * draw(9, 3), "identity": draw(1, 5), "pose": draw(1, 7)}
    sample = model(**{**arguments, **changes})
    return sample.rgb, sample.density, sample.occlusion


def test_ranges_and_the_factor_of_occlusion() -> None:
    model = field()
    rgb, density, occlusion = query(model)
    bare_rgb, bare_density, ones = query(model, pose=None)
    assert ((bare_rgb > 0) & (bare_rgb < 1)).all() and (density > 0).all()
    assert ((occlusion > 0) & (occlusion < 1)).all() and (ones == 1).all()
    torch.testing.assert_close(rgb, bare_rgb * occlusion[:, None])
    torch.testing.assert_close(density, bare_density)


def test_a_fresh_field_is_almost_transparent() -> None:
    """softplus(raw - 1) with raw near zero."""
    model = field()
    torch.nn.init.zeros_(model.density_layer.weight)
    density = query(model)[1]
    torch.testing.assert_close(density, torch.full_like(density, torch.log1p(torch.exp(torch.tensor(-1.0))).item()))


def test_identity_changes_colour_and_density_pose_the_occlusion_alone() -> None:
    model = field()
    rgb, density, occlusion = query(model)
    other_rgb, other_density, _ = query(model, identity=torch.zeros(1, 5, dtype=torch.float64))
    assert (rgb - other_rgb).abs().max() > 1e-3 and (density - other_density).abs().max() > 1e-3
    _, same_density, other_occlusion = query(model, pose=torch.zeros(1, 7, dtype=torch.float64))
    torch.testing.assert_close(density, same_density)
    assert (occlusion - other_occlusion).abs().max() > 1e-3


def test_conditions_by_index_equal_conditions_by_row() -> None:
    model, codes, poses = field(), torch.rand(3, 5, dtype=torch.float64), torch.rand(2, 7, dtype=torch.float64)
    index, pose_index = torch.arange(9) % 3, torch.arange(9) % 2
    indexed = query(model, identity=codes, identity_index=index, pose=poses, pose_index=pose_index)
    rows = query(model, identity=codes[index], pose=poses[pose_index])
    for one, other in zip(indexed, rows, strict=True):
        torch.testing.assert_close(one, other)


def test_density_alone_is_the_same_density() -> None:
    model, means = field(), torch.rand(9, 3, dtype=torch.float64)
    covariances, identity = 1e-3 * torch.ones(9, 3, dtype=torch.float64), torch.rand(1, 5, dtype=torch.float64)
    torch.testing.assert_close(
        model.density(means, covariances, identity), model(means, covariances, identity, None).density
    )


def test_the_input_enters_again_after_the_fifth_layer() -> None:
    sizes = [layer.in_features for layer in field().trunk.layers]
    assert sizes == [24 + 5, 24, 24, 24, 24, 24 + 24 + 5]
    paper = RadianceField(FieldShape(), 64, 7, (0.0, 0.0, 0.0), 1.0).trunk.layers
    assert [layer.out_features for layer in paper] == [256] * 8 and paper[5].in_features == 256 + 60 + 64


def test_gradients_of_every_parameter_match_finite_differences() -> None:
    model = field()
    loss = sum(part.square().sum() for part in query(model))
    names, parameters = zip(*model.named_parameters(), strict=True)
    for name, parameter, gradient in zip(names, parameters, torch.autograd.grad(loss, parameters), strict=True):
        position = int(gradient.abs().argmax())
        flat, values, step = parameter.detach().view(-1), [], 1e-6
        for sign in (1, -1):
            flat[position] += sign * step
            values.append(float(sum(part.square().sum() for part in query(model)).detach()))
            flat[position] -= sign * step
        expected = (values[0] - values[1]) / (2 * step)
        got = float(gradient.flatten()[position])
        assert abs(got - expected) < 1e-5 * max(1.0, abs(expected)), name

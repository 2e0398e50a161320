"""The exact path as a whole: images, gradients, bookkeeping."""

from __future__ import annotations

import dataclasses
import json

import pytest
import torch
from exact_cases import BONES, OBJECT_DISTANCE, SHAPE, frontal_rays, pose_batch, random_figure, small_model

from chona_model.exact import ExactModel
from chona_model.exact_shape import ExactShape
from chona_model.figure import PoseBatch, RayBatch, RayResult
from chona_model.render.integration import EMPTY_DEPTH
from chona_model.settings import ExactSettings, InverseSettings

SETTINGS = ExactSettings(samples=12, inverse=InverseSettings(starts=3))
IMAGES = ("rgb", "alpha", "depth", "human", "object", "confidence")


def render(
    model: ExactModel,
    rays: RayBatch,
    poses: PoseBatch,
    settings: ExactSettings = SETTINGS,
    generator: torch.Generator | None = None,
    **options: object,
) -> RayResult:
    count = len(rays.origins)
    persons, objects = poses.persons[rays.pose], poses.objects[rays.pose]
    assert persons.shape == (count,) and objects.shape == (count, 1)
    return model.render_rays(rays, poses, persons, objects, settings, generator, **options)


def test_an_image_of_a_random_model_is_sound() -> None:
    model, poses = small_model().eval(), pose_batch(random_figure(0.8, 1))
    result = render(model, frontal_rays(6), poses)
    assert result.rgb.shape == (36, 3) and result.regularisers == {} and not result.rgb.requires_grad
    seen = result.alpha > 0  # the outermost rays pass outside canonical space
    assert 20 < seen.sum() < 36 and (result.alpha <= 1).all() and result.alpha.max() > 0.3
    assert (result.rgb <= result.alpha[:, None]).all() and (result.rgb[seen] > 0).all()
    assert ((result.depth[seen] > 1.5) & (result.depth[seen] < 4.0)).all()
    assert (result.depth[~seen] == EMPTY_DEPTH).all()
    assert (result.human + result.object <= result.alpha * (1 + 1e-9)).all()
    assert (result.human[seen] > 0).all() and (result.object[seen] > 0).all()
    assert float(result.failed_share) < 0.2 and (result.confidence > 0.5).all()


def test_rays_that_miss_are_empty_and_cost_nothing() -> None:
    model, poses, rays = small_model().eval(), pose_batch(random_figure(0.8, 1)), frontal_rays(4)
    far = rays.far.clone()
    far[::2] = rays.near[::2]
    mixed = render(model, dataclasses.replace(rays, far=far), poses)
    whole = render(model, rays, poses)
    assert (mixed.alpha[::2] == 0).all() and (mixed.depth[::2] == EMPTY_DEPTH).all()
    assert (mixed.rgb[::2] == 0).all() and (mixed.confidence[::2] == 1).all()
    for name in IMAGES:
        torch.testing.assert_close(getattr(mixed, name)[1::2], getattr(whole, name)[1::2])
    calls: list[int] = []
    model.deform.skinning.register_forward_hook(lambda *_: calls.append(1))
    nothing = render(model, dataclasses.replace(rays, far=rays.near), poses)
    assert not calls and (nothing.alpha == 0).all() and float(nothing.failed_share) == 0.0


def test_chunks_change_nothing() -> None:
    model, poses = small_model().eval(), pose_batch(random_figure(0.8, 1), random_figure(0.8, 2))
    rays = frontal_rays(5, poses=2)
    whole, chunked = render(model, rays, poses), render(model, rays, poses, chunk=7)
    for name in (*IMAGES, "failed_share"):
        torch.testing.assert_close(getattr(whole, name), getattr(chunked, name))


def test_rays_of_several_poses_see_each_their_own() -> None:
    model, figures, rays = small_model().eval(), [random_figure(0.8, seed) for seed in (1, 2)], frontal_rays(4, poses=2)
    both = render(model, rays, pose_batch(*figures))
    for number, figure in enumerate(figures):
        rows = rays.pose == number
        alone = render(model, dataclasses.replace(rays, pose=torch.zeros_like(rays.pose)), pose_batch(figure))
        for name in IMAGES:
            torch.testing.assert_close(getattr(both, name)[rows], getattr(alone, name)[rows])


def test_float32_agrees_with_float64() -> None:
    """Stated bound: 1e-3 of colour and alpha, 1 mm of depth in the mean."""
    poses = random_figure(0.8, 1)
    exact = render(small_model(dtype=torch.float64).eval(), frontal_rays(6), pose_batch(poses))
    single = render(
        small_model(dtype=torch.float32).eval(),
        frontal_rays(6, torch.float32),
        pose_batch(poses, dtype=torch.float32),
    )
    assert single.rgb.dtype == torch.float32
    torch.testing.assert_close(single.rgb.double(), exact.rgb, rtol=0, atol=1e-3)
    torch.testing.assert_close(single.alpha.double(), exact.alpha, rtol=0, atol=1e-3)
    assert (single.depth.double() - exact.depth).abs().mean() < 1e-3


def test_mixed_precision_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rays are torch.float64, the model's parameters torch.float32"):
        render(small_model(dtype=torch.float32), frontal_rays(2), pose_batch(random_figure(0.5, 0)))
    with pytest.raises(ValueError, match="'covariance' is 'round', expected one of warped, plain"):
        render(
            small_model(),
            frontal_rays(2),
            pose_batch(random_figure(0.5, 0)),
            dataclasses.replace(SETTINGS, covariance="round"),
        )


@pytest.mark.parametrize("change", ["offset", "shading", "covariance", "orthographic", "background"])
def test_every_setting_changes_the_image(change: str) -> None:
    model, poses, rays = small_model().eval(), pose_batch(random_figure(0.8, 1)), frontal_rays(4)
    rays = dataclasses.replace(rays, radii=torch.full_like(rays.radii, 0.2))
    settings = {
        "offset": dataclasses.replace(SETTINGS, offset=False),
        "shading": dataclasses.replace(SETTINGS, shading=False),
        "covariance": dataclasses.replace(SETTINGS, covariance="plain"),
        "background": dataclasses.replace(SETTINGS, inverse=InverseSettings(starts=1, background=False)),
    }.get(change, SETTINGS)
    other = render(model, rays, poses, settings, orthographic=change == "orthographic")
    assert (render(model, rays, poses).rgb - other.rgb).abs().max() > 1e-6


def test_jitter_repeats_with_its_generator() -> None:
    model, poses, rays = small_model().eval(), pose_batch(random_figure(0.8, 1)), frontal_rays(3)
    first, again, other = (
        render(model, rays, poses, generator=torch.Generator().manual_seed(seed)).rgb for seed in (1, 1, 2)
    )
    torch.testing.assert_close(first, again, rtol=0, atol=0)
    assert (first - other).abs().max() > 1e-6


def test_codes_colour_each_ray_for_itself() -> None:
    model, poses, rays = small_model().eval(), pose_batch(random_figure(0.8, 1)), frontal_rays(4)
    zeros = torch.zeros(16, dtype=torch.int64)
    base = model.render_rays(rays, poses, zeros, zeros[:, None], SETTINGS).rgb
    mixed = zeros.clone()
    mixed[5], mixed[9] = 1, -1
    changed = (model.render_rays(rays, poses, mixed, zeros[:, None], SETTINGS).rgb - base).abs().amax(dim=1) > 1e-6
    assert changed.nonzero()[:, 0].tolist() == [5, 9]


def test_mattes_follow_the_skinning_weights() -> None:
    """All weight on one bone: the whole alpha is the human's, or the object's, or nobody's."""
    for bone, human, thing in ((3, 1.0, 0.0), (BONES, 0.0, 1.0), (BONES + 1, 0.0, 0.0)):
        result = render(carried_by(bone), frontal_rays(3), pose_batch(random_figure(0.2, 1)))
        torch.testing.assert_close(result.human, human * result.alpha, rtol=1e-6, atol=1e-9)
        torch.testing.assert_close(result.object, thing * result.alpha, rtol=1e-6, atol=1e-9)
        assert result.alpha.max() > 0.05


def test_the_densest_of_several_roots_is_shown() -> None:
    model, poses = small_model().eval(), pose_batch(random_figure(2.5, 1))
    index = torch.zeros(400, dtype=torch.int64)
    targets = 0.8 * (torch.rand(400, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 0.5)
    covariances = 1e-6 * torch.eye(3, dtype=torch.float64).repeat(400, 1, 1)
    identity = model.codes(torch.zeros(1, dtype=torch.int64), torch.zeros(1, 1, dtype=torch.int64))
    with torch.no_grad():
        roots = model.find_canonical(targets, poses, index, ExactSettings())
        chosen, usable = model._densest(roots, covariances, identity, index, poses, index, ExactSettings())
        points = roots.points.reshape(-1, 3)
        density = model.field.density(points, torch.zeros_like(points), identity).view(400, -1)
    inside = (roots.points >= torch.tensor(SHAPE.lower)) & (roots.points <= torch.tensor(SHAPE.upper))
    candidates = roots.distinct & inside.all(dim=-1)
    assert (candidates.sum(dim=-1) > 1).sum() > 20
    best = density.where(candidates, -1.0).argmax(dim=-1)
    assert torch.equal(usable, candidates.any(dim=-1))
    # Covariances of 1 mm against none may swap roots of almost the same density, nothing else.
    assert (chosen == best)[usable].float().mean() > 0.98


def carried_by(bone: int) -> ExactModel:
    """Every point moves with one bone alone, without offset or shading."""
    model = small_model().eval()
    output = model.deform.skinning.mlp.output
    assert output is not None
    with torch.no_grad():
        output.weight.zero_()
        output.bias.zero_()
        output.bias[bone] = 50.0
    return model


def test_the_cones_covariance_is_carried_into_canonical_space() -> None:
    """Turning the bone that carries everything is turning the rays the other way, fat cones included.

    The covariance passed unrotated must fail here: it is what this test is for.
    """
    model, bone = carried_by(9), 9
    poses = pose_batch(random_figure(0.0, 0))
    turn = torch.tensor([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]], dtype=torch.float64)
    rays = dataclasses.replace(frontal_rays(4), radii=torch.full((16,), 0.03, dtype=torch.float64))
    turned_back = dataclasses.replace(rays, origins=rays.origins @ turn, directions=rays.directions @ turn)
    turned = poses.transforms.clone()
    turned[0, bone, :3, :3], turned[0, bone, :3, 3] = turn, 0.0
    images = {}
    for covariance in ("warped", "plain"):
        settings = ExactSettings(samples=6, offset=False, shading=False, covariance=covariance)
        posed = render(model, rays, dataclasses.replace(poses, transforms=turned), settings)
        images[covariance] = (posed.rgb - render(model, turned_back, poses, settings).rgb).abs().max()
    assert images["warped"] < 1e-4 < images["plain"]


def test_a_medium_of_constant_density_absorbs_by_euclidean_length() -> None:
    """Rays have unit length along the camera axis: oblique ones pass through more medium between the same depths."""
    model, poses = carried_by(BONES + 1), pose_batch(random_figure(0.0, 0))
    with torch.no_grad():
        model.field.density_layer.weight.zero_()
    rays = frontal_rays(5)
    rays = dataclasses.replace(rays, near=torch.full_like(rays.near, 2.5), far=torch.full_like(rays.far, 3.0))
    sigma = torch.log1p(torch.exp(torch.tensor(-1.0, dtype=torch.float64)))
    result = render(model, rays, poses, dataclasses.replace(SETTINGS, offset=False))
    expected = 1 - torch.exp(-sigma * 0.5 * rays.directions.norm(dim=-1))
    torch.testing.assert_close(result.alpha, expected)
    assert expected.max() - expected.min() > 0.005


def test_no_rays_and_no_hits_in_training() -> None:
    model, poses, rays = small_model().train(), pose_batch(random_figure(0.5, 0)), frontal_rays(2)
    nothing = RayBatch(**{name: getattr(rays, name)[:0] for name in RayBatch.__dataclass_fields__})
    for batch in (nothing, dataclasses.replace(rays, far=rays.near)):
        result = render(model, batch, poses)
        assert result.rgb.shape == (len(batch.near), 3) and float(result.failed_share) == 0.0
        (result.rgb.sum() + result.regularisers["weights"]).backward()
        assert render(model.eval(), batch, poses).alpha.shape == (len(batch.near),)
        model.train()


def test_the_objects_box_stands_in_front_of_the_root() -> None:
    poses = pose_batch(random_figure(0.5, 1), random_figure(0.5, 2, with_object=False))
    poses = dataclasses.replace(poses, objects=torch.tensor([[1], [-1]]))
    boxes = small_model().canonical_boxes(poses)
    centre = torch.tensor([0.0, 0.0, OBJECT_DISTANCE], dtype=torch.float64)
    torch.testing.assert_close(boxes[0, 0], torch.stack([centre - 0.2, centre + 0.2]))
    torch.testing.assert_close(boxes[1, 0], torch.stack([centre, centre]))


def test_query_canonical_is_the_field_that_rays_see() -> None:
    model = small_model()
    points, pose = torch.rand(4, 3, dtype=torch.float64), pose_batch(random_figure(0.5, 0)).codes
    person, thing = model.codes.person(torch.tensor([1])), model.codes.object(torch.tensor([[2]]))
    sample = model.query_canonical(points, torch.zeros(4, 3).double(), person, thing, pose)
    other = model.field(points, torch.zeros(4, 3).double(), torch.cat([person, thing[0]], dim=-1), pose)
    torch.testing.assert_close(sample.rgb, other.rgb)
    torch.testing.assert_close(sample.density, other.density)


def training_loss(model: ExactModel, poses: PoseBatch, rays: RayBatch) -> torch.Tensor:
    settings = ExactSettings(
        samples=5, covariance="plain", inverse=InverseSettings(starts=3, tolerance=1e-14, steps=60)
    )
    result = render(model, rays, poses, settings)
    target = torch.linspace(0, 1, 3, dtype=torch.float64)
    terms = result.regularisers
    return (result.rgb - target).square().mean() + terms["weights"] + 0.1 * terms["offset"]


def test_training_gradients_match_finite_differences_of_the_image() -> None:
    """Through sampling, root finding, merging, field and integration; the plain covariance has no detached part."""
    model, poses, rays = small_model().train(), pose_batch(random_figure(0.8, 1)), frontal_rays(3)
    names, parameters = zip(*model.named_parameters(), strict=True)
    gradients = torch.autograd.grad(training_loss(model, poses, rays), parameters)
    for name, parameter, gradient in zip(names, parameters, gradients, strict=True):
        if not name.endswith(("output.weight", "codes.persons", "codes.objects", "layers.1.weight")):
            continue
        position = int(gradient.abs().argmax())
        flat, values, step = parameter.detach().view(-1), [], 1e-6
        for sign in (1, -1):
            flat[position] += sign * step
            values.append(float(training_loss(model, poses, rays).detach()))
            flat[position] -= sign * step
        expected = (values[0] - values[1]) / (2 * step)
        got = float(gradient.flatten()[position])
        assert got != 0 and abs(got - expected) < 1e-4 * abs(expected) + 1e-8, (name, got, expected)


def test_a_few_steps_of_training_lower_the_loss() -> None:
    model, poses, rays = small_model(dtype=torch.float32).train(), pose_batch(random_figure(0.8, 1)), frontal_rays(5)
    poses = pose_batch(random_figure(0.8, 1), dtype=torch.float32)
    rays = frontal_rays(5, torch.float32)
    optimiser = torch.optim.Adam(model.parameters(), lr=5e-3)
    losses = []
    for step in range(12):
        result = render(model, rays, poses, generator=torch.Generator().manual_seed(step))
        loss = (result.rgb - torch.tensor([0.6, 0.3, 0.1])).square().mean() + result.regularisers["weights"]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.5 * losses[0]


def test_a_shape_survives_json_and_rebuilds_the_model() -> None:
    shape = ExactShape.from_dict(json.loads(json.dumps(SHAPE.as_dict())))
    assert shape == SHAPE and hash(shape) == hash(SHAPE)
    first, second = small_model(1), ExactModel(shape).double()
    second.load_state_dict(first.state_dict())
    poses, rays = pose_batch(random_figure(0.5, 0)), frontal_rays(2)
    torch.testing.assert_close(render(first.eval(), rays, poses).rgb, render(second.eval(), rays, poses).rgb)


def test_impossible_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="lower < upper"):
        dataclasses.replace(SHAPE, upper=(1.0, -2.0, 1.0))
    with pytest.raises(ValueError, match="a box for each of the 3 objects"):
        dataclasses.replace(SHAPE, object_lower=((0.0, 0.0, 0.0),))


def test_no_object_slots_no_objects_no_cost() -> None:
    shape = dataclasses.replace(SHAPE, object_slots=0, n_objects=0, object_lower=(), object_upper=())
    torch.manual_seed(0)
    model = ExactModel(shape).double().eval()
    figure = random_figure(0.5, 0, with_object=False)
    poses = pose_batch(dataclasses.replace(figure, transforms=figure.transforms[:-1], present=figure.present[:-1]))
    poses = dataclasses.replace(poses, objects=torch.zeros(1, 0, dtype=torch.int64))
    rays = frontal_rays(2)
    result = model.render_rays(
        rays, poses, torch.zeros(4, dtype=torch.int64), torch.zeros(4, 0, dtype=torch.int64), SETTINGS
    )
    assert (result.object == 0).all() and (result.human > 0).all()

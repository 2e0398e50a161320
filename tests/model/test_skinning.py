"""Forward skinning: weights, exact Jacobian, absent bones, and the two ways to start the weights."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from exact_cases import BONES, OBJECT_DISTANCE, REST_JOINTS, SHAPE, pose_batch, random_figure, small_model

from chona_model.data.dataset import SkinnedSurface
from chona_model.deform.initialise import initialise_from_bones, initialise_from_surface
from chona_model.deform.regularisers import bone_regularisers
from chona_model.deform.skinning import DeformShape, OffsetMLP, SkinningMLP, softmax_weights
from chona_model.geometry import segment_distances
from chona_model.skeleton import SMPL

TAILS = SMPL.bone_tails(REST_JOINTS)
OBJECT = np.array([0.0, 0.0, OBJECT_DISTANCE])
EXTENT = {"lower": np.array(SHAPE.lower), "upper": np.array(SHAPE.upper)}


def random_points(count: int, seed: int = 0) -> torch.Tensor:
    generator = np.random.default_rng(seed)
    return torch.tensor(generator.uniform(-0.8, 0.8, (count, 3)))


@pytest.mark.parametrize("offset", [True, False])
def test_the_jacobian_matches_finite_differences(offset: bool) -> None:
    model, poses = small_model().deform, pose_batch(random_figure(1.0, 1), random_figure(2.0, 2))
    x, index, step = random_points(30), torch.arange(30) % 2, 1e-6
    with torch.no_grad():
        posed, jacobian = model.with_jacobian(x, poses, index, offset)
        torch.testing.assert_close(posed, model(x, poses, index, offset))
        for axis in range(3):
            shift = step * torch.eye(3, dtype=torch.float64)[axis]
            ahead, behind = (model(x + sign * shift, poses, index, offset) for sign in (1, -1))
            torch.testing.assert_close(jacobian[:, :, axis], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-6)


def test_the_jacobian_is_far_from_the_blended_rotation_alone() -> None:
    """The weights' derivative must matter here, or the test above would pass without it."""
    model, poses = small_model().deform, pose_batch(random_figure(1.0, 1))
    x, index = random_points(30), torch.zeros(30, dtype=torch.int64)
    with torch.no_grad():
        jacobian = model.with_jacobian(x, poses, index, offset=False)[1]
        blended = torch.einsum("mj,jab->mab", model.weights(x, poses, index)[:, :-1], poses.transforms[0, :, :3, :3])
    assert (jacobian - blended).abs().max() > 0.1


def test_forward_is_the_papers_sum() -> None:
    model, figure = small_model().deform, random_figure(1.0, 4)
    poses, x, index = pose_batch(figure), random_points(5), torch.zeros(5, dtype=torch.int64)
    with torch.no_grad():
        got = model(x, poses, index)
        weights = model.weights(x, poses, index)
        expected = model.offset(x, poses.codes)
        for j in range(BONES + 1):
            turned = x @ torch.tensor(figure.transforms[j, :3, :3]).T + torch.tensor(figure.transforms[j, :3, 3])
            expected = expected + weights[:, j : j + 1] * turned
        expected = expected + weights[:, -1:] * x
    torch.testing.assert_close(got, expected)


def test_one_pose_and_many_agree() -> None:
    model, figures = small_model().deform, [random_figure(1.0, seed) for seed in range(3)]
    x = random_points(12)
    many = model.with_jacobian(x, pose_batch(*figures), torch.arange(12) % 3)
    for number, figure in enumerate(figures):
        rows = torch.arange(12) % 3 == number
        one = model.with_jacobian(x[rows], pose_batch(figure), torch.zeros(4, dtype=torch.int64))
        torch.testing.assert_close(one[0], many[0][rows])
        torch.testing.assert_close(one[1], many[1][rows])


def test_absent_bones_weigh_nothing_and_the_rest_sums_to_one() -> None:
    model, poses = small_model().deform, pose_batch(random_figure(1.0, 1, with_object=False), random_figure(1.0, 2))
    weights = model.weights(random_points(20), poses, torch.arange(20) % 2)
    assert (weights[::2, BONES] == 0).all() and (weights[1::2, BONES] > 0).all()
    torch.testing.assert_close(weights.sum(dim=-1), torch.ones(20, dtype=torch.float64))


def test_absence_changes_nothing_but_the_share_of_the_others() -> None:
    logits = torch.randn(8, 6, generator=torch.Generator().manual_seed(0))
    present = torch.tensor([[True, False, True, True, False]])
    weights = softmax_weights(logits, present)
    keep = [0, 2, 3, 5]
    torch.testing.assert_close(weights[:, keep], torch.softmax(logits[:, keep], dim=-1))


def test_a_fresh_offset_is_below_a_tenth_of_a_millimetre() -> None:
    torch.manual_seed(0)
    offset = OffsetMLP(DeformShape(), 153, (0.0, 0.0, 0.0), 1.0)
    moved = offset(random_points(500).float(), torch.rand(1, 153))
    assert 0 < moved.abs().max() < 1e-3


def test_regularisers_vanish_for_one_hot_weights_and_count_present_bones_alone() -> None:
    class OneHot(torch.nn.Module):
        def weights(self, x: torch.Tensor, poses: object, index: torch.Tensor) -> torch.Tensor:
            distance = (x[:, None] - torch.tensor(REST_JOINTS)).norm(dim=-1)
            return torch.nn.functional.one_hot(distance.argmin(dim=-1), BONES + 2).to(x)

        def offset(self, x: torch.Tensor, codes: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
            return torch.full_like(x, 0.5)

    poses = pose_batch(random_figure(1.0, 1, with_object=False))
    poses = dataclasses.replace(poses, tails=poses.heads)
    boxes = torch.zeros(1, 1, 2, 3, dtype=torch.float64)
    terms = bone_regularisers(OneHot(), poses, boxes)
    assert float(terms["weights"]) == 0.0 and float(terms["offset"]) == 0.25
    present = dataclasses.replace(poses, present=torch.ones_like(poses.present))
    # The object's samples sit on the pelvis here: 5 of 125 rows are wrong by two entries of 26.
    assert float(bone_regularisers(OneHot(), present, boxes)["weights"]) == pytest.approx(2 / 26 / 25)


def test_drawn_regulariser_points_lie_on_the_segments_and_in_the_boxes() -> None:
    seen: dict[str, torch.Tensor] = {}

    class Recorder(torch.nn.Module):
        def weights(self, x: torch.Tensor, poses: object, index: torch.Tensor) -> torch.Tensor:
            seen["points"], seen["poses"] = x, index
            return torch.zeros(len(x), BONES + 2, dtype=x.dtype)

        def offset(self, x: torch.Tensor, codes: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
            return torch.zeros_like(x)

    poses = pose_batch(*[random_figure(0.5, seed) for seed in range(11)])
    centre = torch.tensor(OBJECT)
    boxes = torch.stack([centre - 0.2, centre + 0.2]).expand(11, 1, 2, 3)
    draws = []
    for seed in (1, 1, 2):
        bone_regularisers(Recorder(), poses, boxes, torch.Generator().manual_seed(seed))
        draws.append(seen["points"].view(8, BONES + 1, 5, 3))
    assert torch.equal(draws[0], draws[1]) and not torch.equal(draws[0], draws[2])
    body, thing = draws[0][:, :BONES], draws[0][:, BONES]
    heads, tails = torch.tensor(REST_JOINTS)[:, None], torch.tensor(TAILS)[:, None]
    assert segment_distances(body, heads, tails).max() < 1e-12
    offsets = thing - centre
    assert offsets.abs().max() <= 0.2 and offsets.std(dim=(0, 1)).min() > 0.08
    assert torch.corrcoef(offsets.reshape(-1, 3).T).triu(1).abs().max() < 0.6


def fit(kind: str) -> tuple[SkinningMLP, float]:
    torch.manual_seed(0)
    skinning = SkinningMLP(DeformShape(width=64, depth=4), BONES + 1, SHAPE.centre, SHAPE.scale)
    boxes = [(OBJECT - 0.2, OBJECT + 0.2)]
    if kind == "bones":
        error = initialise_from_bones(skinning, REST_JOINTS, TAILS, boxes, **EXTENT, steps=150, batch=512)
    else:
        generator = np.random.default_rng(0)
        bone = generator.integers(0, BONES, 3000)
        vertices = REST_JOINTS[bone] + generator.random((3000, 1)) * (TAILS[bone] - REST_JOINTS[bone])
        surface = SkinnedSurface(vertices, np.eye(BONES)[bone], np.zeros((0, 3), dtype=np.int64))
        error = initialise_from_surface(skinning, surface, boxes, **EXTENT, steps=150, batch=512)
    return skinning, error


@pytest.mark.parametrize("kind", ["bones", "surface"])
def test_started_weights_know_limbs_object_and_background(kind: str) -> None:
    skinning, error = fit(kind)
    assert error < 0.01
    places = {
        "left_elbow": 0.5 * (REST_JOINTS[18] + REST_JOINTS[20]),
        "right_knee": 0.5 * (REST_JOINTS[5] + REST_JOINTS[8]),
        "object": OBJECT,
        "background": np.array([0.9, -0.9, 0.3]),
    }
    wanted = [18, 5, BONES, BONES + 1]
    with torch.no_grad():
        weights = skinning(torch.tensor(np.array(list(places.values())), dtype=torch.float32))
    assert weights.argmax(dim=-1).tolist() == wanted
    assert (weights.max(dim=-1).values > torch.tensor([0.5, 0.5, 0.9, 0.9])).all()


def test_initialisation_refuses_the_wrong_number_of_boxes() -> None:
    skinning = SkinningMLP(DeformShape(width=8, depth=2), BONES + 1, SHAPE.centre, SHAPE.scale)
    with pytest.raises(ValueError, match="26 outputs, but 24 bones, 0 object boxes"):
        initialise_from_bones(skinning, REST_JOINTS, TAILS, [], **EXTENT)

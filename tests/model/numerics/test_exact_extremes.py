"""Whole renders of poses and cameras at the ends of what an animator can make."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from exact_cases import (
    BONES,
    OBJECT_DISTANCE,
    REST_JOINTS,
    RIG,
    SHAPE,
    frontal_rays,
    pose_batch,
    random_figure,
    small_model,
)
from scipy.spatial.transform import Rotation

from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.exact import ExactModel
from chona_model.figure import Figure, PoseBatch, RayBatch, RayResult, make_figure
from chona_model.render.integration import EMPTY_DEPTH
from chona_model.settings import ExactSettings, InverseSettings
from chona_model.skeleton import SMPL, forward_kinematics

SETTINGS = ExactSettings(samples=12, inverse=InverseSettings(starts=3))


def check(model: ExactModel, poses: PoseBatch, rays: RayBatch) -> RayResult:
    """Renders and trains: everything finite, values in range."""
    persons, objects = poses.persons[rays.pose], poses.objects[rays.pose]
    model.zero_grad()
    result = model.train().render_rays(rays, poses, persons, objects, SETTINGS)
    (result.rgb.sum() + result.alpha.sum() + sum(result.regularisers.values())).backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() < 1e6, name
    result = model.eval().render_rays(rays, poses, persons, objects, SETTINGS)
    for name in ("rgb", "alpha", "depth", "human", "object", "confidence", "failed_share"):
        assert torch.isfinite(getattr(result, name)).all(), name
    assert ((result.alpha >= 0) & (result.alpha <= 1 + 1e-6)).all()
    assert ((result.confidence >= 0) & (result.confidence <= 1 + 1e-6)).all()
    return result


def one_bone_model(bone: int) -> ExactModel:
    """Float32 weights of 1/2 each on the root and one other bone, whatever the point."""
    model = small_model(dtype=torch.float32)
    output = model.deform.skinning.mlp.output
    assert output is not None
    with torch.no_grad():
        output.weight.zero_()
        output.bias.fill_(-50.0)
        output.bias[[0, bone]] = 50.0
    torch.nn.init.zeros_(model.deform.offset.mlp.output.weight)
    return model


def test_opposed_bones_at_equal_weight_fail_openly() -> None:
    """A half turn between two bones at weights ½ collapses space onto a line: nothing has a root, nothing breaks."""
    poses = pose_batch(random_figure(0.0, 0), dtype=torch.float32)
    poses.transforms[0, 3] = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
    result = check(one_bone_model(3), poses, frontal_rays(4, torch.float32))
    assert float(result.failed_share) == 1.0 and (result.confidence == 0).all() and (result.alpha == 0).all()


@pytest.mark.parametrize("kind", ["zero", "mirrored", "tiny", "sheared", "duplicated"])
def test_broken_bone_matrices(kind: str) -> None:
    poses = pose_batch(random_figure(0.5, 0), dtype=torch.float32)
    change = {
        "zero": torch.zeros(3, 3),
        "mirrored": torch.diag(torch.tensor([-1.0, 1.0, 1.0])),
        "tiny": 1e-12 * torch.eye(3),
        "sheared": torch.tensor([[1.0, 5.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        "duplicated": poses.transforms[0, 9, :3, :3],
    }[kind]
    poses.transforms[0, 12:, :3, :3] = change
    check(small_model(dtype=torch.float32), poses, frontal_rays(5, torch.float32))


def test_bones_of_zero_length() -> None:
    poses = pose_batch(random_figure(0.5, 0), dtype=torch.float32)
    poses = dataclasses.replace(poses, tails=poses.heads)
    check(small_model(dtype=torch.float32), poses, frontal_rays(5, torch.float32))
    poses = dataclasses.replace(poses, heads=torch.zeros_like(poses.heads), tails=torch.zeros_like(poses.heads))
    check(small_model(dtype=torch.float32), poses, frontal_rays(5, torch.float32))


@pytest.mark.parametrize("place", [(50.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1e4, 0.0, 0.0)])
def test_objects_far_away_and_inside_the_body(place: tuple[float, ...]) -> None:
    objects = np.eye(4)[None].copy()
    objects[0, :3, 3] = place
    world = forward_kinematics(SMPL, REST_JOINTS, np.tile(np.eye(3), (BONES, 1, 1)), np.zeros(3))
    poses = pose_batch(make_figure(RIG, world, objects, 1), dtype=torch.float32)
    check(small_model(dtype=torch.float32), poses, frontal_rays(5, torch.float32))


def test_absent_objects_and_absent_persons() -> None:
    model = small_model(dtype=torch.float32)
    poses = pose_batch(random_figure(0.5, 0, with_object=False), dtype=torch.float32)
    poses = dataclasses.replace(poses, objects=torch.tensor([[-1]]))
    result = check(model, poses, frontal_rays(5, torch.float32))
    assert (result.object == 0).all() and (result.human > 0).any()
    alone = make_figure(RIG, None, np.eye(4)[None], 1)
    poses = dataclasses.replace(pose_batch(alone, dtype=torch.float32), persons=torch.tensor([-1]))
    rays = frontal_rays(5, torch.float32)
    rays = dataclasses.replace(rays, origins=rays.origins + torch.tensor([0.0, 0.0, OBJECT_DISTANCE]))
    result = check(model, poses, rays)
    assert (result.human == 0).all() and (result.object > 0).any()


def test_the_camera_inside_the_body_and_rays_along_bones() -> None:
    poses = pose_batch(random_figure(0.5, 0), dtype=torch.float32)
    head, tail = torch.tensor(REST_JOINTS[3]).float(), torch.tensor(REST_JOINTS[6]).float()
    rays = dataclasses.replace(
        frontal_rays(3, torch.float32),
        origins=head.expand(9, 3),
        directions=((tail - head) / (tail - head).norm()).expand(9, 3),
        near=torch.zeros(9),
    )
    check(small_model(dtype=torch.float32), poses, rays)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.parametrize("where", ["origins", "directions", "radii", "near", "far"])
def test_rays_that_are_not_finite_are_marked_and_counted(where: str, bad: float) -> None:
    model, poses = small_model(dtype=torch.float32), pose_batch(random_figure(0.5, 0), dtype=torch.float32)
    rays, zeros = frontal_rays(3, torch.float32), torch.zeros(9, dtype=torch.int64)
    field = getattr(rays, where).clone()
    field[4] = bad
    damaged = dataclasses.replace(rays, **{where: field})
    result = model.eval().render_rays(damaged, poses, zeros, zeros[:, None], SETTINGS)
    whole = model.render_rays(rays, poses, zeros, zeros[:, None], SETTINGS)
    assert float(result.alpha[4]) == 0 and float(result.depth[4]) == EMPTY_DEPTH and float(result.confidence[4]) == 0
    others = torch.arange(9) != 4
    torch.testing.assert_close(result.rgb[others], whole.rgb[others])
    assert float(result.failed_share) >= 1 / 9 - 1e-6
    with pytest.raises(ValueError, match="1 of 9 rays hold values that are not finite"):
        model.train().render_rays(damaged, poses, zeros, zeros[:, None], SETTINGS)


@pytest.mark.parametrize("angle", [0.0, 1e-8, np.pi - 1e-6, np.pi, np.pi + 1e-6])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rotations_by_nothing_and_by_half_turns(axis: int, angle: float) -> None:
    """An elbow turned about each axis: points of the forearm are found again, and a render stays finite."""
    turns = np.tile(np.eye(3), (BONES, 1, 1))
    turns[18] = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
    world = forward_kinematics(SMPL, REST_JOINTS, turns, np.zeros(3))
    poses = pose_batch(make_figure(RIG, world, np.eye(4)[None], 1), dtype=torch.float32)
    model = small_model(dtype=torch.float32)
    x = torch.tensor(REST_JOINTS[18] + np.linspace(0.3, 0.9, 20)[:, None] * (REST_JOINTS[20] - REST_JOINTS[18])).float()
    index = torch.zeros(20, dtype=torch.int64)
    output = model.deform.skinning.mlp.output
    assert output is not None
    with torch.no_grad():
        output.bias[18] = 3.0  # the forearm's own bone dominates, the others still pull
        targets = model.deform(x, poses, index)
    roots = model.find_canonical(targets, poses, index, ExactSettings())
    found = ((roots.points - x[:, None]).norm(dim=-1) < 1e-3) & roots.converged
    assert found.any(dim=-1).float().mean() >= 0.9
    check(model, poses, frontal_rays(4, torch.float32))


@pytest.mark.parametrize("degrees", [0.1, 60.0, 170.0])
def test_fields_of_view(degrees: float) -> None:
    focal = 4.0 / np.tan(np.radians(degrees) / 2)
    camera = Camera(np.array([[focal, 0, 4], [0, focal, 4], [0, 0, 1]]), np.diag([1.0, -1.0, -1.0, 1.0]), 8, 8)
    distance = min(0.4 / np.tan(np.radians(degrees) / 2), 800.0)
    camera.world_from_camera[2, 3] = distance + 0.3
    figure = random_figure(0.5, 0)
    rays = camera_rays(figure, camera, max(distance - 1.0, 0.0), distance + 1.0)
    result = check(small_model(dtype=torch.float32), pose_batch(figure, dtype=torch.float32), rays)
    assert result.alpha.max() > 0.01


def test_an_orthographic_camera() -> None:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 3.0
    figure, model = random_figure(0.5, 0), small_model(dtype=torch.float32).eval()
    camera = Camera(np.array([[4.0, 0, 4], [0, 4.0, 4], [0, 0, 1]]), pose, 8, 8, ORTHOGRAPHIC)
    rays = camera_rays(figure, camera, 1.5, 4.5, radius=0.1)
    zeros, poses = torch.zeros(64, dtype=torch.int64), pose_batch(figure, dtype=torch.float32)
    near = model.render_rays(rays, poses, zeros, zeros[:, None], SETTINGS, orthographic=True)
    away = dataclasses.replace(
        rays, origins=rays.origins - 64 * rays.directions, near=rays.near + 64, far=rays.far + 64
    )
    far = model.render_rays(away, poses, zeros, zeros[:, None], SETTINGS, orthographic=True)
    assert near.alpha.max() > 0.1
    torch.testing.assert_close(near.rgb, far.rgb, rtol=0, atol=1e-3)
    torch.testing.assert_close(far.depth[near.alpha > 0] - 64, near.depth[near.alpha > 0], rtol=0, atol=1e-2)


def camera_rays(figure: Figure, camera: Camera, near: float, far: float, radius: float | None = None) -> RayBatch:
    """Float32 rays through all pixel centres; mip-NeRF's base radius unless one is given."""
    origins, directions = figure.rays(camera, camera.pixel_centres().reshape(-1, 2))
    ones = torch.ones(len(origins))
    base = 2 / np.sqrt(12) / camera.intrinsics[0, 0] if radius is None else radius
    return RayBatch(
        torch.tensor(origins, dtype=torch.float32),
        torch.tensor(directions, dtype=torch.float32),
        float(base) * ones,
        near * ones,
        far * ones,
        torch.zeros(len(origins), dtype=torch.int64),
    )


def photograph(shift: tuple[float, ...], dtype: torch.dtype) -> RayResult:
    """The figure and its camera, both moved by ``shift`` metres, through the package's own float64 path."""
    figure = random_figure(0.8, 1, shift=shift)
    world_from_camera = np.diag([1.0, -1.0, -1.0, 1.0])
    world_from_camera[:3, 3] = np.array([0.0, 0.0, 3.0]) + shift
    camera = Camera(np.array([[12.0, 0, 4], [0, 12.0, 4], [0, 0, 1]]), world_from_camera, 8, 8)
    origins, directions = figure.rays(camera, camera.pixel_centres().reshape(-1, 2))
    count = len(origins)
    rays = RayBatch(
        torch.as_tensor(origins, dtype=dtype),
        torch.as_tensor(directions, dtype=dtype),
        torch.full((count,), 2e-3, dtype=dtype),
        torch.full((count,), 1.5, dtype=dtype),
        torch.full((count,), 4.0, dtype=dtype),
        torch.zeros(count, dtype=torch.int64),
    )
    zeros = torch.zeros(count, dtype=torch.int64)
    model = small_model(dtype=dtype).eval()
    return model.render_rays(rays, pose_batch(figure, dtype=dtype), zeros, zeros[:, None], SETTINGS)


@pytest.mark.parametrize(("distance", "bound"), [(1e4, 1e-5), (1e5, 1e-4), (1e6, 1e-3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_figure_far_from_the_origin_looks_the_same(distance: float, bound: float, dtype: torch.dtype) -> None:
    here = photograph((0.0, 0.0, 0.0), dtype)
    there = photograph((distance, -0.7 * distance, 0.3 * distance), dtype)
    assert here.alpha.max() > 0.2
    torch.testing.assert_close(there.rgb, here.rgb, rtol=0, atol=bound)
    torch.testing.assert_close(there.alpha, here.alpha, rtol=0, atol=bound)
    assert (there.depth - here.depth)[here.alpha > 0.01].abs().max() < 100 * bound


def test_a_turned_figure_seen_by_a_turned_camera_looks_the_same() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    world = forward_kinematics(SMPL, REST_JOINTS, np.tile(np.eye(3), (BONES, 1, 1)), np.zeros(3))
    objects = np.eye(4)[None].copy()
    camera = np.diag([1.0, -1.0, -1.0, 1.0])
    camera[2, 3] = 3.0
    images = []
    for rotation in (np.eye(3), turn):
        move = np.eye(4)
        move[:3, :3] = rotation
        figure = make_figure(RIG, move @ world, move @ objects, 1)
        view = Camera(np.array([[12.0, 0, 4], [0, 12.0, 4], [0, 0, 1]]), move @ camera, 8, 8)
        origins, directions = (torch.tensor(part) for part in figure.rays(view, view.pixel_centres().reshape(-1, 2)))
        ones, zeros = torch.ones(64, dtype=torch.float64), torch.zeros(64, dtype=torch.int64)
        rays = RayBatch(origins, directions, 1e-3 * ones, 1.5 * ones, 4.0 * ones, zeros)
        result = small_model().eval().render_rays(rays, pose_batch(figure), zeros, zeros[:, None], SETTINGS)
        images.append(result.rgb)
    torch.testing.assert_close(images[0], images[1], rtol=0, atol=1e-8)


def test_canonical_space_ends_at_its_box() -> None:
    """Rays far outside meet roots (the background's) but no density."""
    rays = frontal_rays(3, torch.float32)
    aside = dataclasses.replace(rays, origins=rays.origins + torch.tensor([10.0, 0.0, 0.0]))
    model, poses = small_model(dtype=torch.float32).eval(), pose_batch(random_figure(0.0, 0), dtype=torch.float32)
    zeros = torch.zeros(9, dtype=torch.int64)
    result = model.render_rays(aside, poses, zeros, zeros[:, None], SETTINGS)
    assert (result.alpha == 0).all() and SHAPE.upper[0] < 2

"""The normal pass: closed forms, finite differences of the density, twins of the kernel, what does not change it."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from ball_model import ball_actor, ball_pose, looking_at, normals_of_ball
from blur_scenes import at, card_shot, shutter_times
from exact_cases import frontal_rays, pose_batch, random_figure, small_model
from scene_files import grid_file, write_poses
from scipy.spatial.transform import Rotation
from tiny_models import trained

from chona_model.blur import Blur
from chona_model.camera import ORTHOGRAPHIC
from chona_model.data.dataset import Pose
from chona_model.formats.exr import FrameHeader, read_frame, write_frame
from chona_model.formats.shot import read_shot
from chona_model.frame import ShotRenderer, render_frame, unit_normals
from chona_model.grid_actor import GridActor
from chona_model.model_store import load_actor
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.samples import composite
from chona_model.settings import RENDER_PRESETS, ExactSettings

WITH_NORMALS = Passes(normal=True)
FINAL = RENDER_PRESETS["final"]
HEADER = FrameHeader("m" * 64, "s" * 64, "final", "{}", 1.0, 1)


def degrees_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angles of unit vectors [..., 3]."""
    return np.degrees(np.arccos(np.clip((one * other).sum(axis=-1), -1.0, 1.0)))


@pytest.mark.parametrize("kind", ["PERSP", ORTHOGRAPHIC])
@pytest.mark.parametrize("preset", ["draft", "final"])
def test_a_ball_faces_outwards_in_the_world(kind: str, preset: str) -> None:
    """Whatever way the object's frame and the camera are turned, far from the world's origin."""
    centre = np.array([100.0, -40.0, 3.0])
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix(), centre
    camera = looking_at(centre, Rotation.from_rotvec([-2.1, 0.3, 0.5]).as_matrix(), (48, 40), kind)
    picture = ball_actor().render(ball_pose(frame), camera, RENDER_PRESETS[preset], passes=WITH_NORMALS)
    assert picture.normal is not None
    found, expected = unit_normals(picture.normal), normals_of_ball(camera, centre)
    facing = -expected @ camera.world_from_camera[:3, 2]
    seen = (picture.alpha > 0.95) & (facing > 0.4)
    assert seen.sum() > 300
    angles = degrees_between(found, expected)[seen]
    assert angles.mean() < 3.0 and angles.max() < 10.0, f"{angles.max():.1f} degrees off"
    np.testing.assert_allclose(np.linalg.norm(found[picture.alpha > 0], axis=-1), 1.0, atol=1e-5)
    assert not found[picture.alpha == 0].any()
    assert (np.linalg.norm(picture.normal, axis=-1) <= picture.alpha + 1e-5).all(), "weighted as colours are"


def test_a_rolled_camera_turns_the_picture_and_no_normal() -> None:
    centre, turn = np.zeros(3), Rotation.from_rotvec([1.8, 0.2, -0.3]).as_matrix()
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # right becomes down
    actor, pose = ball_actor(), ball_pose(np.eye(4))
    upright, rolled = (
        actor.render(pose, looking_at(centre, axes, (40, 40)), FINAL, passes=WITH_NORMALS)
        for axes in (turn, turn @ quarter)
    )
    assert upright.normal is not None and rolled.normal is not None and upright.alpha.max() > 0.9
    np.testing.assert_allclose(np.rot90(rolled.normal, -1), upright.normal, atol=2e-3)


@pytest.fixture(scope="module")
def scene():
    dataset, trainer = trained(250, objects=2)
    return GridActor(trainer.model), replace(dataset.views[1], camera=dataset.views[1].camera.scaled(0.5))


def test_normals_turn_with_the_world(scene) -> None:
    """Figure and camera turned together: the same picture, its normals turned."""
    actor, view = scene
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = Rotation.from_rotvec([0.7, -0.4, 1.9]).as_matrix(), [3.0, -2.0, 1.0]
    pose = Pose(
        view.pose.person, view.pose.objects, move @ view.pose.world_from_bone, move @ view.pose.world_from_object
    )
    camera = replace(view.camera, world_from_camera=move @ view.camera.world_from_camera)
    here = actor.render(view.pose, view.camera, FINAL, passes=WITH_NORMALS)
    there = actor.render(pose, camera, FINAL, passes=WITH_NORMALS)
    assert here.normal is not None and there.normal is not None
    np.testing.assert_allclose(here.normal @ move[:3, :3].T, there.normal, atol=5e-3)
    assert np.abs(here.normal).max() > 0.5


def test_most_of_what_is_seen_faces_the_camera(scene) -> None:
    actor, view = scene
    camera = view.camera.scaled(2.0)  # half the capture's size has 76 such pixels
    picture = actor.render(view.pose, camera, FINAL, passes=WITH_NORMALS)
    _, directions = camera.rays(np.argwhere(picture.alpha > 0.9)[:, ::-1] + 0.5)
    assert picture.normal is not None
    towards = -(directions * unit_normals(picture.normal)[picture.alpha > 0.9]).sum(axis=-1)
    person = picture.human[picture.alpha > 0.9] > 0.5
    assert person.sum() > 50 and (towards[person] > 0).all()
    # The small box is smoothed, too: along its edges normals turn by 45 degrees, and a face seen from its side may
    # face away.
    assert (~person).sum() > 50 and (towards[~person] > 0).mean() > 0.8


def test_the_stages_face_as_the_kernel_does(scene) -> None:
    """In double precision through plain tensors, whose normals go with the inverse Jacobian, person and objects."""
    actor, view = scene
    settings = replace(FINAL, newton_steps=12, stop=0.0)
    passes = Passes(normal=True, cryptomatte=True)
    staged = GridActor(deepcopy(actor.model).double())
    one, other = (each.render(view.pose, view.camera, settings, passes=passes) for each in (actor, staged))
    seen = (one.alpha > 0.5) & (other.alpha > 0.5)
    for name in ("normal", "parts"):
        difference = np.abs(getattr(one, name) - getattr(other, name))[seen]
        assert np.quantile(difference, 0.99) < 1e-2 and difference.mean() < 1e-3, name
    assert one.parts is not None and (one.parts.max(axis=(0, 1)) > 0.3).all()


def test_samples_make_the_picture(scene) -> None:
    actor, view = scene
    settings, passes = replace(FINAL, stop=0.0), Passes(normal=True, cryptomatte=True)
    for each in (actor, GridActor(deepcopy(actor.model).double())):
        picture = each.render(view.pose, view.camera, settings, passes=passes)
        seen = picture.alpha > 0
        samples = each.sample(view.pose, view.camera, settings, seen, passes)
        again = composite([samples], view.camera, settings.supersampling, picture, seen)
        for name in ("normal", "parts"):
            np.testing.assert_allclose(getattr(again, name), getattr(picture, name), atol=3e-5, err_msg=name)


def test_what_is_not_asked_for_is_not_there(scene) -> None:
    actor, view = scene
    plain = actor.render(view.pose, view.camera, FINAL)
    assert plain.normal is None and plain.parts is None
    detailed = actor.render(view.pose, view.camera, FINAL, passes=WITH_NORMALS)
    for name, channel in plain.channels.items():
        np.testing.assert_array_equal(getattr(detailed, name), channel, err_msg=name)
    assert detailed.parts is None


# The exact path


def test_exact_normals_are_the_slope_of_the_posed_density() -> None:
    """Finite differences of the density at posed points, each inverted for itself, in a bent pose with its offset."""
    model, poses = small_model().eval(), pose_batch(random_figure(0.8, 1))
    generator = torch.Generator().manual_seed(0)
    points = 0.5 * (torch.rand(60, 3, generator=generator, dtype=torch.float64) - 0.5)
    rays = replace(frontal_rays(1), pose=torch.zeros(len(points), dtype=torch.int64))
    covariances = 1e-8 * torch.eye(3, dtype=torch.float64).expand(len(points), 1, 3, 3)
    codes = model.codes(torch.zeros(len(points), dtype=torch.int64), torch.zeros(len(points), 1, dtype=torch.int64))
    settings = ExactSettings(covariance="plain")

    def sampled(at: torch.Tensor, facing: bool = False):
        with torch.no_grad():
            return model._sample(
                at[:, None], covariances, rays.pose, poses, identity=codes, settings=settings, facing=facing
            )

    step, slopes = 1e-5, []
    for axis in range(3):
        move = torch.zeros(3, dtype=torch.float64)
        move[axis] = step
        slopes.append((sampled(points + move).density - sampled(points - move).density)[:, 0] / (2 * step))
    slope = torch.stack(slopes, dim=-1)
    found = sampled(points, facing=True)
    assert found.normal is not None
    smooth = (found.density[:, 0] > 0) & (slope.norm(dim=-1) > 1e-3) & (slope.norm(dim=-1) < 1e3)
    expected = -slope / slope.norm(dim=-1, keepdim=True)
    agree = (found.normal[:, 0] * expected).sum(dim=-1)[smooth]
    assert smooth.sum() > 30
    # At a few points two roots change places within the step.
    assert (agree > 1 - 1e-6).double().mean() > 0.9, agree


def test_exact_pictures_weigh_normals_as_colours() -> None:
    model, poses, rays = small_model().eval(), pose_batch(random_figure(0.8, 1)), frontal_rays(5)
    zeros, settings = torch.zeros(25, dtype=torch.int64), ExactSettings(samples=16)
    result = model.render_rays(rays, poses, zeros, zeros[:, None], settings, facing=True)
    plain = model.render_rays(rays, poses, zeros, zeros[:, None], settings)
    depth, opacity, _, shares, normals = model.sample_rays(rays, poses, zeros, zeros[:, None], settings, facing=True)
    light = torch.cumprod(torch.cat([torch.ones(25, 1).double(), 1 - opacity], dim=-1), dim=-1)[:, :-1]
    assert result.normal is not None and normals is not None and depth.shape == opacity.shape
    torch.testing.assert_close(
        result.normal, ((light * opacity)[..., None] * normals).sum(dim=1), rtol=1e-9, atol=1e-12
    )
    torch.testing.assert_close(result.mattes, ((light * opacity)[..., None] * shares).sum(dim=1), rtol=1e-9, atol=1e-12)
    assert plain.normal is None and torch.equal(plain.rgb, result.rgb)
    assert (result.normal.norm(dim=-1) <= result.alpha + 1e-9).all() and result.normal.norm(dim=-1).max() > 0.01


# Frames


def test_frames_keep_normals_of_length_one(tmp_path: Path) -> None:
    """Two actors, of whom one stands before the other; half precision; empty behind the clip range."""
    model, dataset = grid_file()
    first, second, camera = dataset.views[0].pose, dataset.views[2].pose, dataset.views[0].camera
    shot = read_shot(write_poses(tmp_path / "two.shot.npz", camera, [first], [replace(second, objects=(),
                     world_from_object=np.zeros((0, 4, 4)))]))  # fmt: skip
    actor = load_actor(model)
    layers = render_frame(actor, shot, 0, RENDER_PRESETS["draft"], passes=WITH_NORMALS)
    assert layers.normal is not None
    length = np.linalg.norm(layers.normal, axis=-1)
    assert (np.abs(length[layers.combined[..., 3] > 0.1] - 1.0) < 1e-5).mean() > 0.99
    assert not length[layers.combined[..., 3] == 0].any()
    write_frame(tmp_path / "two_0001.exr", layers, HEADER)
    again, _ = read_frame(tmp_path / "two_0001.exr")
    assert again.normal is not None and again.passes == WITH_NORMALS
    np.testing.assert_allclose(again.normal, layers.normal, atol=5e-4)
    near = replace(shot, clip=np.array([[0.01, 0.02]]))
    cut = render_frame(actor, near, 0, RENDER_PRESETS["draft"], passes=WITH_NORMALS)
    assert cut.normal is not None and not cut.normal.any()
    assert render_frame(actor, shot, 0, RENDER_PRESETS["draft"], passes=DEFAULT_PASSES).normal is None


def test_blurred_frames_weigh_normals_and_mattes_as_colours() -> None:
    """A ball that rolls past in the shutter's time: in the middle it faces the camera on the whole."""
    shot = card_shot(lambda time: at(x=0.2 * time, z=1.5), times=shutter_times(8, -0.5, 0.5), size=(40, 32), focal=60.0)
    shot = replace(shot, actors=(replace(shot.actors[0], objects=("ball",)),))
    actor, passes = ball_actor(), Passes(normal=True, cryptomatte=True)
    layers, plain = (
        ShotRenderer([actor], shot, RENDER_PRESETS["preview"], each, blur=Blur(True, False, 16)).render(0)
        for each in (passes, DEFAULT_PASSES)
    )
    alpha = layers.combined[..., 3]
    assert layers.normal is not None and layers.cryptomatte is not None
    np.testing.assert_allclose(layers.cryptomatte.coverage[..., 0], alpha, atol=1e-5)
    assert ((alpha > 0.1) & (alpha < 0.9)).sum() > 40, "its sides are blurred"
    np.testing.assert_allclose(np.linalg.norm(layers.normal[alpha > 0.05], axis=-1), 1.0, atol=1e-5)
    middle = layers.normal[15:17, 19:21].mean(axis=(0, 1))
    assert degrees_between(middle / np.linalg.norm(middle), np.array([0.0, 0.0, -1.0])) < 4.0
    np.testing.assert_allclose(plain.combined, layers.combined, atol=1e-6)

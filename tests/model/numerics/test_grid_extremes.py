"""Whole renders of the default path at the ends of what can be posed and seen: dtype × device × preset × pose."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch
from grid_cases import POSES, placed, scene, turned

from chona_model.actor import EMPTY_DEPTH, Picture
from chona_model.camera import Camera
from chona_model.data.dataset import Pose
from chona_model.figure import FARTHEST
from chona_model.grid_actor import GridActor
from chona_model.settings import PRESETS, RENDER_PRESETS

CUDA = [pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="no graphics card with CUDA")]


@pytest.fixture(
    scope="module",
    params=["cpu float32", "cpu float64", pytest.param("cuda float32", marks=CUDA)],
)
def actor(request: pytest.FixtureRequest) -> GridActor:
    """The kernels of whole rays, the stages of tensors, and those on a graphics card."""
    device, dtype = request.param.split()
    return GridActor(deepcopy(scene()[0]).to(device=device, dtype=getattr(torch, dtype)))


@pytest.fixture(params=PRESETS)
def preset(request: pytest.FixtureRequest) -> str:
    return request.param


def sound(picture: Picture) -> Picture:
    """Everything finite and in range."""
    for name in ("rgb", "alpha", "depth", "human", "object", "confidence"):
        assert np.isfinite(getattr(picture, name)).all(), name
    for name in ("alpha", "human", "object", "confidence"):
        assert (getattr(picture, name) >= 0).all() and (getattr(picture, name) <= 1 + 1e-5).all(), name
    np.testing.assert_allclose(picture.human + picture.object, picture.alpha, atol=1e-5)
    assert (picture.depth[picture.alpha == 0] == EMPTY_DEPTH).all() and (picture.depth > 0).all()
    assert 0 <= picture.failed_share <= 1
    return picture


@pytest.mark.parametrize("name", POSES)
def test_every_pose_gives_a_sound_picture(actor: GridActor, name: str) -> None:
    """At the preset with the fewest rays that takes every step: one ray a pixel, both starts."""
    view, settings = scene()[1], replace(RENDER_PRESETS["preview"], step=0.025)
    picture = sound(actor.render(POSES[name](view.pose), view.camera, settings))
    if name != "object farther":
        assert picture.alpha.max() > 0.5


def test_every_preset_gives_a_sound_picture(actor: GridActor, preset: str) -> None:
    view, settings = scene()[1], RENDER_PRESETS[preset]
    settings = replace(settings, step=max(settings.step, 0.025), supersampling=1)
    sound(actor.render(POSES["opposed"](view.pose), view.camera, settings))


@pytest.mark.parametrize("name", POSES)
def test_kernels_in_float32_show_what_stages_show_in_float64(name: str) -> None:
    """Rays whose samples fall within rounding of a cell's border may differ by a sample, or by a root at a fold."""
    model, view = scene()
    pose, settings = (
        POSES[name](view.pose),
        replace(RENDER_PRESETS["final"], step=0.025, supersampling=1, newton_steps=20, stop=0.0),
    )
    fused = GridActor(model).render(pose, view.camera, settings)
    exact = GridActor(model).render(pose, view.camera, replace(settings, precision="float64"))
    difference = np.abs(fused.alpha - exact.alpha)
    assert difference.mean() < 2e-3 and np.quantile(difference, 0.95) < 1e-2
    assert np.abs(fused.rgb - exact.rgb).mean() < 2e-3
    assert fused.failed_share == pytest.approx(exact.failed_share, abs=0.02)


def test_a_collapsed_bone_is_marked_in_the_confidence() -> None:
    """Points between a turned chest and hips of half weights have no root: those pixels say so, and it is counted."""
    model, view = scene()
    actor = GridActor(model)
    whole, broken = (
        actor.render(POSES[name](view.pose), view.camera, RENDER_PRESETS["final"]) for name in ("as it is", "opposed")
    )
    assert whole.failed_share < 0.05
    assert broken.failed_share > 2 * whole.failed_share
    assert broken.confidence.min() < 0.6 and (broken.confidence < 0.9).sum() > (whole.confidence < 0.9).sum()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_poses_that_are_not_finite_are_refused_by_name(bad: float) -> None:
    model, view = scene()
    actor = GridActor(model)
    bones, things = view.pose.world_from_bone.copy(), view.pose.world_from_object.copy()
    bones[1, 0, 3], things[0, 1, 1] = bad, bad
    reason = "values beyond" if np.isfinite(bad) else "not finite"
    for pose, name in (
        (replace(view.pose, world_from_bone=bones), "bone 'chest'"),
        (replace(view.pose, world_from_object=things), "object 1"),
    ):
        with pytest.raises(ValueError, match=f"{name} has a matrix .*{reason}"):
            actor.render(pose, view.camera, RENDER_PRESETS["draft"])


def test_a_person_spread_over_kilometres_is_refused_before_memory_is_taken() -> None:
    model, view = scene()
    bones = view.pose.world_from_bone.copy()
    bones[2, :3, 3] += 0.01 * FARTHEST
    with pytest.raises(ValueError, match=r"spreads the person over .* m;"):
        GridActor(model).render(replace(view.pose, world_from_bone=bones), view.camera, RENDER_PRESETS["draft"])


def looking(view_camera: Camera, degrees: float, distance: float, size: tuple[int, int]) -> Camera:
    """A camera on the same line of sight, so far from the middle of the scene, with a field of view across."""
    width, height = size
    focal = 0.5 * width / np.tan(np.radians(degrees) / 2)
    pose = view_camera.world_from_camera.copy()
    pose[:3, 3] = np.array([0.0, -0.15, 0.05]) - distance * pose[:3, 2]
    return Camera(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]), pose, width, height)


@pytest.mark.parametrize(
    ("degrees", "distance"), [(0.1, 900.0), (60.0, 1.5), (170.0, 0.3), (170.0, 0.0), (90.0, -0.05)]
)
def test_fields_of_view_and_cameras_inside_the_volume(actor: GridActor, degrees: float, distance: float) -> None:
    view = scene()[1]
    picture = sound(
        actor.render(view.pose, looking(view.camera, degrees, distance, (12, 12)), RENDER_PRESETS["preview"])
    )
    assert picture.alpha.max() > 0.5
    if distance > 1:
        assert np.abs(picture.depth[picture.alpha > 0.9] - distance).max() < 1.0


def test_a_camera_that_looks_along_a_bone(actor: GridActor) -> None:
    view = scene()[1]
    chest, head = view.pose.world_from_bone[1:3, :3, 3]
    axis = (head - chest) / np.linalg.norm(head - chest)
    side = np.linalg.qr(np.column_stack([axis, np.eye(3)]))[0][:, 1]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.column_stack([side, np.cross(axis, side), axis]), chest - 1.5 * axis
    camera = Camera(np.array([[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]]), pose, 16, 16)
    assert sound(actor.render(view.pose, camera, RENDER_PRESETS["preview"])).alpha[6:10, 6:10].max() > 0.5


def test_a_picture_of_one_pixel(actor: GridActor, preset: str) -> None:
    view = scene()[1]
    settings = replace(RENDER_PRESETS[preset], step=0.016)
    picture = sound(actor.render(view.pose, looking(view.camera, 20.0, 2.4, (1, 1)), settings))
    assert picture.alpha.shape == (1, 1)


def test_a_very_large_picture_costs_what_it_shows() -> None:
    """8192 x 4096 pixels of which the figure covers some hundred: those alone are traced, and are the same as alone."""
    model, view = scene()
    actor, small = GridActor(model), looking(view.camera, 40.0, 2.4, (24, 18))
    wide = small.intrinsics.copy()
    wide[:2, 2] += 6000, 3000
    large = replace(small, intrinsics=wide, width=8192, height=4096)
    expected = actor.render(view.pose, small, RENDER_PRESETS["preview"])
    found = actor.render(view.pose, large, RENDER_PRESETS["preview"])
    assert found.rays <= 2000
    np.testing.assert_allclose(found.alpha[3000:3018, 6000:6024], expected.alpha, atol=2e-3)
    assert found.alpha.max() > 0.5 and not found.alpha[:2900].any()


def test_an_object_inside_the_body_hides_nothing_it_should_not() -> None:
    """What lies at one place is seen once: alpha stays within 1, and both parts have their share."""
    model, view = scene()
    inside = GridActor(model).render(placed(view.pose, (0.0, 0.0, 0.15)), view.camera, RENDER_PRESETS["final"])
    assert inside.alpha.max() <= 1 + 1e-6 and inside.object.max() > 0.1 and inside.human.max() > 0.1


@pytest.mark.parametrize("metres", [1e4, 1e6])
def test_where_an_extreme_pose_stands_does_not_matter(metres: float) -> None:
    model, view = scene()
    pose, move = turned(view.pose, 1, np.diag([1.0, -1.0, -1.0])), metres * np.array([1.0, -0.5, 0.2])

    def there(matrices: np.ndarray) -> np.ndarray:
        moved = matrices.copy()
        moved[..., :3, 3] += move
        return moved

    far = Pose(pose.person, pose.objects, there(pose.world_from_bone), there(pose.world_from_object))
    camera = replace(view.camera, world_from_camera=there(view.camera.world_from_camera))
    one, other = (
        GridActor(model).render(p, c, RENDER_PRESETS["final"]) for p, c in ((pose, view.camera), (far, camera))
    )
    assert np.quantile(np.abs(one.rgb - other.rgb), 0.99) < 1e-3 and np.abs(one.rgb - other.rgb).mean() < 1e-4

"""Rendering of grid models: shortcuts against the exact preset, files, far away figures, absent parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_models import lit, trained, unlit

from chona_model.actor import EMPTY_DEPTH
from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.data.dataset import Pose
from chona_model.evaluate.metrics import psnr
from chona_model.formats.model_file import read_header
from chona_model.grid_actor import GridActor
from chona_model.model_store import load_actor, save_actor
from chona_model.settings import RENDER_PRESETS


@pytest.fixture(scope="module")
def scene():
    dataset, trainer = trained()
    return trainer.actor(), dataset.views[1]


def test_presets_come_nearer_to_exact_in_their_order(scene) -> None:
    actor, view = scene
    pictures = {name: actor.render(view.pose, view.camera, RENDER_PRESETS[name]) for name in RENDER_PRESETS}
    near = [psnr(np.clip(pictures[name].rgb, 0, 1), np.clip(pictures["exact"].rgb, 0, 1)) for name in RENDER_PRESETS]
    assert near == sorted(near)
    assert near[2] > 28.0


def test_a_model_file_renders_the_same_picture(scene, tmp_path) -> None:
    actor, view = scene
    path = tmp_path / "model.safetensors"
    save_actor(path, actor, "chona", {"preset": "fast"}, {"steps": 3})
    again = load_actor(path)
    one, other = (a.render(view.pose, view.camera, RENDER_PRESETS["final"]) for a in (actor, again))
    np.testing.assert_array_equal(one.rgb, other.rgb)
    np.testing.assert_array_equal(one.depth, other.depth)
    header = read_header(path)
    assert header.field == "grid"
    np.testing.assert_array_equal(header.rest_joints("Sub01"), actor.persons["Sub01"].rest_joints)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("metres", [1e4, 1e6])
def test_where_the_figure_stands_does_not_matter(scene, metres: float, turned: bool) -> None:
    """Nor, without a light, does how it is turned there."""
    actor, view = scene
    move = np.eye(4)
    if turned:
        actor = GridActor(unlit(actor.model))
        move[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 1.0]).as_matrix()
    else:
        actor = GridActor(lit(actor.model))
    move[:3, 3] = metres * np.array([1.0, -0.5, 0.2])
    bones, things = move @ view.pose.world_from_bone, move @ view.pose.world_from_object
    pose = Pose(view.pose.person, view.pose.objects, bones, things)
    camera = replace(view.camera, world_from_camera=move @ view.camera.world_from_camera)
    here, there = (actor.render(p, c, RENDER_PRESETS["final"]) for p, c in ((view.pose, view.camera), (pose, camera)))
    assert np.abs(here.rgb - there.rgb).max() < 1e-3
    seen = here.alpha > 0.5
    np.testing.assert_allclose(here.depth[seen], there.depth[seen], atol=1e-3)


def test_depth_is_metres_along_the_axis(scene) -> None:
    actor, view = scene
    picture = actor.render(view.pose, view.camera, RENDER_PRESETS["exact"])
    middle = view.pose.world_from_object[0, :3, 3]
    (pixel, depth) = view.camera.project(middle)
    column, row = int(pixel[0]), int(pixel[1])
    # The box's centre lies between 8 and 17 cm behind its surface.
    assert 0.03 < depth - picture.depth[row, column] < 0.22
    assert (picture.depth[picture.alpha == 0] == EMPTY_DEPTH).all()


def test_parts_may_be_absent(scene) -> None:
    actor, view = scene
    alone = Pose(view.pose.person, (), view.pose.world_from_bone, np.zeros((0, 4, 4)))
    picture = actor.render(alone, view.camera, RENDER_PRESETS["final"])
    assert picture.object.max() == 0.0
    assert picture.human.max() > 0.8
    thing = Pose(None, view.pose.objects, np.zeros((0, 4, 4)), view.pose.world_from_object)
    picture = actor.render(thing, view.camera, RENDER_PRESETS["final"])
    assert picture.human.max() == 0.0
    assert picture.object.max() > 0.8


def test_behind_the_camera_nothing_is_traced(scene) -> None:
    actor, view = scene
    turned = view.camera.world_from_camera @ np.diag([-1.0, 1.0, -1.0, 1.0])
    picture = actor.render(view.pose, replace(view.camera, world_from_camera=turned), RENDER_PRESETS["final"])
    assert picture.rays == 0
    assert picture.alpha.max() == 0.0


def test_unknown_identities_are_named(scene) -> None:
    actor, view = scene
    with pytest.raises(KeyError, match="no person 'Nobody'; it has: Sub01"):
        actor.render(replace(view.pose, person="Nobody"), view.camera, RENDER_PRESETS["draft"])


def test_orthographic_cameras_see_the_same_figure(scene) -> None:
    """A far camera with a long lens converges to the orthographic picture."""
    actor, view = scene
    width, height, metres = 64, 48, 1.5
    scale = height / metres
    axis = view.camera.world_from_camera[:3, 2]

    def camera(distance: float, kind: str) -> Camera:
        pose = view.camera.world_from_camera.copy()
        pose[:3, 3] = np.array([0.0, -0.15, 0.05]) - distance * axis
        focal = scale if kind == ORTHOGRAPHIC else scale * distance
        return Camera(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]), pose, width, height, kind)

    flat = actor.render(view.pose, camera(5.0, ORTHOGRAPHIC), RENDER_PRESETS["exact"])
    far = actor.render(view.pose, camera(5000.0, "PERSP"), RENDER_PRESETS["exact"])
    assert psnr(np.clip(flat.rgb, 0, 1), np.clip(far.rgb, 0, 1)) > 28.0
    seen = (flat.alpha > 0.9) & (far.alpha > 0.9)
    assert np.abs(far.depth[seen] - flat.depth[seen] - 4995.0).mean() < 0.02

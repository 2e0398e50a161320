"""Training of the paper's networks on the tiny capture: the loss falls, resuming changes nothing, files come back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny_capture import tiny_capture

from chona_model.data.images import load_pixels
from chona_model.deform.skinning import DeformShape
from chona_model.exact_actor import ExactActor
from chona_model.field.radiance import FieldShape
from chona_model.model_store import load_actor, save_actor
from chona_model.render.bounds import figure_spans
from chona_model.settings import RENDER_PRESETS, ExactSettings, InverseSettings
from chona_model.train.exact_trainer import ExactTrainer, PaperSettings, make_shape
from chona_model.train.objects import object_distance

FEW = ExactSettings(samples=16, inverse=InverseSettings(starts=2, steps=8, tolerance=1e-4, predict=0.05), bounded=True)
SETTINGS = PaperSettings(rays=96, first_rate=2e-3, last_rate=5e-4, exact=FEW, chunk=64, initial_steps=60)
RENDER = replace(RENDER_PRESETS["draft"], resolution=1.0, exact=FEW)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return tiny_capture(tmp_path_factory.mktemp("capture"), persons=2, objects=2, frames=2, cameras=2, size=(24, 18))


def trainer_of(capture) -> ExactTrainer:
    shape = make_shape(capture, object_distance(capture))
    small = replace(
        shape, code_size=4, deform=replace(DeformShape(), width=24, depth=2),
        radiance=replace(FieldShape(), width=32, depth=3),
    )  # fmt: skip
    return ExactTrainer(capture, SETTINGS, 0, shape=small)


def test_loss_falls_and_resuming_changes_nothing(capture) -> None:
    whole, first = trainer_of(capture), trainer_of(capture)
    losses = [whole.step(index, index / 40)["loss"] for index in range(40)]
    assert np.mean(losses[-8:]) < 0.8 * np.mean(losses[:8])
    for index in range(23):
        first.step(index, index / 40)
    resumed = trainer_of(capture)
    resumed.restore(first.state(), 23)
    for index in range(23, 40):
        resumed.step(index, index / 40)
    expected, got = whole.state(), resumed.state()
    assert expected.keys() == got.keys()
    assert all(torch.equal(value, got[name]) for name, value in expected.items())


def test_a_model_file_renders_the_same_picture(capture, tmp_path) -> None:
    actor = trainer_of(capture).actor()
    view = capture.views[0]
    save_actor(tmp_path / "model.safetensors", actor, "chona", {}, {})
    again = load_actor(tmp_path / "model.safetensors")
    assert isinstance(again, ExactActor)
    one, other = (a.render(view.pose, view.camera, RENDER) for a in (actor, again))
    np.testing.assert_array_equal(one.rgb, other.rgb)
    assert one.rays == other.rays > 0


def test_bounds_hold_the_whole_figure(capture) -> None:
    """Every pixel of the masks lies inside the spans, and the surface's depth between near and far."""
    actor = trainer_of(capture).actor()
    for view in capture.views:
        figure, rig, _ = actor.figure(view.pose)
        near, far = figure_spans(figure, rig, actor.boxes(view.pose.objects), view.camera)
        mask = load_pixels(view).mask
        assert mask.any()
        assert (far > near)[mask].all()
        pixel, depth = view.camera.project(view.pose.world_from_object[0, :3, 3])
        column, row = int(pixel[0]), int(pixel[1])
        assert near[row, column] < depth < far[row, column]
        assert (far > near).mean() < 0.7, "bounds that keep everything bound nothing"


def test_where_the_figure_stands_does_not_matter(capture) -> None:
    actor, view = trainer_of(capture).actor(), capture.views[0]
    move = np.eye(4)
    move[:3, 3] = [1e6, -3e5, 2e4]
    pose = replace(
        view.pose,
        world_from_bone=move @ view.pose.world_from_bone,
        world_from_object=move @ view.pose.world_from_object,
    )
    camera = replace(view.camera, world_from_camera=move @ view.camera.world_from_camera)
    here, there = actor.render(view.pose, view.camera, RENDER), actor.render(pose, camera, RENDER)
    assert np.abs(here.rgb - there.rgb).max() < 1e-3


def test_unknown_identities_are_named(capture) -> None:
    actor, view = trainer_of(capture).actor(), capture.views[0]
    with pytest.raises(KeyError, match="no object 'piano'; it has: box01, box02"):
        actor.render(replace(view.pose, objects=("piano",)), view.camera, RENDER)

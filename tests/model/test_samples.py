"""Actors merged sample by sample: against closed forms, one trace of everything, and layers of separate pictures."""

from __future__ import annotations

from dataclasses import replace

import bound_cases
import numpy as np
import pytest
from tiny_models import trained

from chona_model.actor import EMPTY_DEPTH, Picture, Samples, empty_picture
from chona_model.camera import Camera
from chona_model.data.dataset import Pose
from chona_model.evaluate.metrics import psnr
from chona_model.grid_actor import GridActor
from chona_model.samples import beside_each_other, composite, densest, join, over_each_other
from chona_model.settings import RENDER_PRESETS

FINE = replace(RENDER_PRESETS["final"], stop=0.0, supersampling=1)


def one_ray(*samples: tuple[float, float, float], thing: float = 0.0) -> Samples:
    """Samples (depth, alpha, grey) of the ray of pixel (0, 1) of a picture two pixels wide."""
    depth, alpha, grey = (np.array(column, np.float32) for column in zip(*samples, strict=True))
    rgb = np.repeat(grey[:, None], 3, axis=1)
    return Samples(np.full(len(depth), 1), depth, alpha, rgb, np.full(len(depth), thing, np.float32))


def integrated(*actors: Samples) -> Picture:
    camera = Camera(np.eye(3), np.eye(4), 2, 1)
    return composite(actors, camera, 1, empty_picture(camera), np.ones((1, 2), bool))


def test_two_interleaved_volumes_by_hand() -> None:
    person, thing = one_ray((1.0, 0.5, 1.0), (3.0, 0.5, 0.2)), one_ray((2.0, 0.4, 0.6), (4.0, 1.0, 0.0), thing=1.0)
    picture = integrated(person, thing)
    # Light: 1 | 0.5 at the first of the thing | 0.3 | 0.15 | 0.
    weights = [0.5, 0.5 * 0.4, 0.3 * 0.5, 0.15]
    assert picture.alpha[0, 1] == pytest.approx(1.0)
    assert picture.rgb[0, 1, 0] == pytest.approx(0.5 * 1.0 + 0.2 * 0.6 + 0.15 * 0.2)
    assert picture.human[0, 1] == pytest.approx(weights[0] + weights[2])
    assert picture.object[0, 1] == pytest.approx(weights[1] + weights[3])
    assert picture.depth[0, 1] == pytest.approx((0.5 * 1 + 0.15 * 3) / 0.65), "the depth of the one that shows most"
    assert picture.alpha[0, 0] == 0 and picture.depth[0, 0] == EMPTY_DEPTH


def test_the_order_of_actors_does_not_matter() -> None:
    random = np.random.default_rng(0)
    actors = []
    for number in range(3):
        count = 200
        actors.append(
            Samples(
                random.integers(0, 2, count), random.random(count).astype(np.float32) + number * 1e-3,
                random.random(count).astype(np.float32), random.random((count, 3)).astype(np.float32),
                random.random(count).astype(np.float32),
            )
        )  # fmt: skip
    one, other = integrated(*actors), integrated(*actors[::-1])
    np.testing.assert_allclose(one.rgb, other.rgb, atol=1e-6)
    together = integrated(join(actors))
    np.testing.assert_allclose(one.alpha, together.alpha, atol=1e-6)
    np.testing.assert_allclose(one.rgb, together.rgb, atol=1e-6)


def test_the_densest_of_one_sample_counts() -> None:
    ray, depth = np.array([0, 0, 0, 1, 1]), np.array([1.0, 1.0, 2.0, 1.0, 1.0])
    assert list(densest(ray, depth, np.array([1.0, 5.0, 2.0, 3.0, 0.5]))) == [1, 2, 3]
    assert len(densest(np.zeros(0), np.zeros(0), np.zeros(0))) == 0


@pytest.fixture(scope="module")
def scene():
    dataset, trainer = trained()
    return trainer.actor(), dataset.views[1]


def test_one_actors_samples_make_its_picture(scene) -> None:
    actor, view = scene
    for settings in (FINE, replace(FINE, supersampling=2)):
        picture = actor.render(view.pose, view.camera, settings)
        seen = picture.alpha > 0
        samples = actor.sample(view.pose, view.camera, settings, seen)
        again = composite([samples], view.camera, settings.supersampling, picture, seen)
        for name in ("rgb", "alpha", "object", "human"):
            np.testing.assert_allclose(getattr(again, name), getattr(picture, name), atol=2e-5, err_msg=name)
        np.testing.assert_allclose(again.depth[seen], picture.depth[seen], atol=1e-4)


def test_stages_of_tensors_give_the_same_samples(scene) -> None:
    actor, view = scene
    view = replace(view, camera=view.camera.scaled(0.25))
    settings = replace(FINE, step=0.02)
    pixels = np.ones((view.camera.height, view.camera.width), bool)
    double = GridActor(actor.model)._in("float64")
    pictures = [
        composite(
            [each.sample(view.pose, view.camera, settings, pixels)], view.camera, 1, empty_picture(view.camera), pixels
        )
        for each in (actor, double)
    ]
    assert psnr(pictures[0].rgb.clip(0, 1), pictures[1].rgb.clip(0, 1)) > 50


def test_apart_they_are_what_one_trace_of_both_is(scene) -> None:
    """Person and object as two actors against the same as one actor, whose kernel traces both together."""
    actor, view = scene
    inside = view.pose.world_from_object.copy()
    inside[0, :3, 3] = view.pose.world_from_bone[1, :3, 3] + 0.05 * np.array([1.0, -1.0, 0.0])
    view = replace(view, pose=replace(view.pose, world_from_object=inside))
    person = Pose(view.pose.person, (), view.pose.world_from_bone, np.zeros((0, 4, 4)))
    thing = Pose(None, view.pose.objects, np.zeros((0, 4, 4)), view.pose.world_from_object)
    whole = actor.render(view.pose, view.camera, FINE)
    pictures = [actor.render(pose, view.camera, FINE) for pose in (person, thing)]
    layered, both = beside_each_other(pictures), over_each_other(pictures)
    assert both.sum() > 20
    samples = [actor.sample(pose, view.camera, FINE, both) for pose in (person, thing)]
    merged = composite(samples, view.camera, 1, layered, both)
    error = [np.abs(each.rgb - whole.rgb)[both].mean() for each in (merged, layered)]
    # Samples of the two actors lie at other depths than those of one trace, and colours know the other's code.
    assert error[0] < 0.05 and error[0] < 0.5 * error[1], error
    np.testing.assert_array_equal(merged.rgb[~both], layered.rgb[~both])


def test_the_papers_path_gives_its_samples_too() -> None:
    actor, view = bound_cases.scene("exact")
    settings = replace(bound_cases.exact_settings("exact"), supersampling=2)
    picture = actor.render(view.pose, view.camera, settings)
    seen = picture.alpha > 0
    again = composite([actor.sample(view.pose, view.camera, settings, seen)], view.camera, 2, picture, seen)
    assert picture.alpha.max() > 0.8
    np.testing.assert_allclose(again.rgb, picture.rgb, atol=1e-5)
    np.testing.assert_allclose(again.alpha, picture.alpha, atol=1e-5)
    solid = picture.alpha > 0.1
    np.testing.assert_allclose(again.depth[solid], picture.depth[solid], rtol=1e-3)

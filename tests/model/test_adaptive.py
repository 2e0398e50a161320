"""Views with an error bound, against the top rung of their ladder rendered whole."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tiny_models import trained

from chona_model.actor import Actor, Picture
from chona_model.adaptive import FINEST_STEP, RUNGS, Render, ladder, render_within
from chona_model.camera import Camera
from chona_model.data.dataset import View
from chona_model.settings import RENDER_PRESETS

PREVIEW = RENDER_PRESETS["preview"]


@pytest.fixture(scope="module")
def scene() -> tuple[Actor, View, Picture]:
    """A model, a view of it, and the view with the finest settings everywhere."""
    dataset, trainer = trained()
    view = dataset.views[1]
    view = replace(view, camera=view.camera.scaled(0.5))
    actor = trainer.actor()
    return actor, view, actor.render(view.pose, view.camera, ladder(PREVIEW)[-1])


def of(actor: Actor, view: View) -> Render:
    """Renders a view of one actor."""
    return lambda settings, pixels: actor.render(view.pose, view.camera, settings, pixels)


def apart(one: Picture, other: Picture) -> np.ndarray:
    return np.maximum(np.abs(one.rgb - other.rgb).max(axis=-1), np.abs(one.alpha - other.alpha))


@pytest.mark.parametrize("bound", [0.2, 0.05])
def test_pixels_lie_within_the_bound_of_the_finest_settings(scene, bound: float) -> None:
    actor, view, finest = scene
    picture, reached = render_within(of(actor, view), PREVIEW, bound)
    plain = actor.render(view.pose, view.camera, PREVIEW)
    assert apart(plain, finest).max() > bound, "nothing to refine: the test would pass without refining"
    assert (apart(picture, finest) > bound).sum() <= reached.unsettled
    assert reached.asked == bound and 0 < reached.refined <= reached.pixels
    assert (reached.error <= bound) == (reached.unsettled == 0)
    whole = finest.rays * ladder(PREVIEW)[-1].supersampling ** 2
    assert reached.rays < whole, "refining cost more than rendering everything finely"


def test_a_tighter_bound_comes_nearer_and_costs_more(scene) -> None:
    actor, view, finest = scene
    results = [render_within(of(actor, view), PREVIEW, bound) for bound in (0.3, 0.1, 0.02)]
    errors = [float(np.sqrt((apart(picture, finest) ** 2).mean())) for picture, _ in results]
    assert errors == sorted(errors, reverse=True)
    rays = [reached.rays for _, reached in results]
    assert rays == sorted(rays) and rays[0] < rays[-1]


def test_what_agrees_is_not_rendered_again(scene) -> None:
    actor, view, _ = scene
    picture, reached = render_within(of(actor, view), PREVIEW, 1.0)
    second = actor.render(view.pose, view.camera, ladder(PREVIEW)[1])
    np.testing.assert_array_equal(picture.rgb, second.rgb)
    assert (reached.rungs, reached.refined, reached.unsettled) == (2, 0, 0)


def test_what_never_settles_is_counted(scene) -> None:
    actor, view, finest = scene
    picture, reached = render_within(of(actor, view), PREVIEW, 1e-7)
    assert reached.unsettled > 0 and reached.rungs == RUNGS
    assert reached.error == pytest.approx(
        apart(picture, actor.render(view.pose, view.camera, ladder(PREVIEW)[2])).max()
    )
    same = apart(picture, finest) < 1e-6
    assert same[finest.alpha > 0].mean() > 0.8, "pixels that agreed by chance on the way up should be few"
    assert f"{reached.unsettled} of {reached.pixels} pixels above 1e-07" in reached.sentence()


def test_an_empty_view_is_within_any_bound(scene) -> None:
    actor, view, _ = scene
    away = view.camera.world_from_camera @ np.diag([-1.0, 1.0, -1.0, 1.0])
    camera = Camera(view.camera.intrinsics, away, view.camera.width, view.camera.height)
    picture, reached = render_within(of(actor, replace(view, camera=camera)), PREVIEW, 0.01)
    assert picture.alpha.max() == 0 and (reached.error, reached.pixels, reached.rays) == (0.0, 0, 0)


@pytest.mark.parametrize("name", RENDER_PRESETS)
def test_every_rung_is_at_least_as_fine_as_the_one_below(name: str) -> None:
    rungs = ladder(replace(RENDER_PRESETS[name], occupancy_cell=2, occupancy_threshold=3.0))
    assert len(rungs) == RUNGS and rungs[0].resolution == 1.0
    for lower, upper in pairwise(rungs):
        assert FINEST_STEP <= upper.step <= lower.step and upper.stop <= lower.stop
        assert upper.supersampling >= lower.supersampling and upper.newton_steps > lower.newton_steps
        assert upper.exact.samples >= lower.exact.samples and upper.exact.inverse.starts >= lower.exact.inverse.starts
        assert upper.offset and upper.shading and upper.occupancy_cell == 1 and upper.occupancy_threshold == 0.0

"""Every setting's distance from the exact path on small trained models: what ``docs/accuracy.md`` bounds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from tiny_capture import tiny_capture
from tiny_models import trained

from chona_model.actor import Actor, Picture
from chona_model.data.dataset import View
from chona_model.deform.skinning import DeformShape
from chona_model.field.radiance import FieldShape
from chona_model.settings import RENDER_PRESETS, ExactSettings, InverseSettings, RenderSettings
from chona_model.trade.knobs import Knob
from chona_model.trade.measure import differences
from chona_model.train.exact_trainer import ExactTrainer, PaperSettings, make_shape
from chona_model.train.objects import object_distance
from chona_model.train.repeatable import repeatable

STEPS = 80
"""Of training the small model of the paper's path."""


@cache
def scene(kind: str) -> tuple[Actor, View]:
    """A small trained model of a kind, and a view."""
    if kind == "grid":
        dataset, trainer = trained()
        return trainer.actor(), dataset.views[1]
    dataset = tiny_capture(Path(mkdtemp()), frames=2, cameras=3, size=(24, 18))
    shape = make_shape(dataset, object_distance(dataset))
    small = replace(
        shape, code_size=4, deform=replace(DeformShape(), width=24, depth=2),
        radiance=replace(FieldShape(), width=48, depth=3),
    )  # fmt: skip
    exact = ExactSettings(samples=16, inverse=InverseSettings(2, 8, tolerance=1e-4, predict=0.05), bounded=True)
    settings = PaperSettings(rays=96, first_rate=4e-3, last_rate=1e-3, exact=exact, chunk=128, initial_steps=120)
    with repeatable("cpu"):  # or every run measures another model
        slow = ExactTrainer(dataset, settings, 0, shape=small)
        for index in range(STEPS):
            slow.step(index, index / STEPS)
    return slow.actor(), dataset.views[1]


def exact_settings(kind: str, knob: Knob | None = None) -> RenderSettings:
    """What a knob is compared with: the exact preset, with what the knob takes for granted.

    On the paper's path with one ray a pixel: rays do not see each other.
    """
    exact = RENDER_PRESETS["exact"]
    if kind == "exact":
        predicted = replace(exact.exact.inverse, predict=0.05 if knob and "roots" in knob.name else 0.0)
        return replace(exact, exact=replace(exact.exact, inverse=predicted), supersampling=1)
    skips = knob is not None and knob.name.startswith("occupancy_")
    return replace(exact, occupancy=True) if skips else exact


def turned(kind: str, knob: Knob) -> RenderSettings:
    """The exact settings with one knob turned."""
    return knob.applied(exact_settings(kind, knob))


@cache
def picture(kind: str, settings: RenderSettings) -> Picture:
    """The view of a scene."""
    actor, view = scene(kind)
    return actor.render(view.pose, view.camera, settings)


def measured(kind: str, knob: Knob) -> tuple[float, float, float]:
    """Colour (RMS over the figure), alpha (mean) and depth (mean, metres) against the exact settings."""
    error, alpha, depth = differences(
        picture(kind, turned(kind, knob)), picture(kind, exact_settings(kind, knob))
    )  # fmt: skip
    assert depth is not None, "nothing solid to compare"
    return error, alpha, depth

"""Registers everything in one order, takes it back in the other, and leaves nothing behind when a step fails."""

from __future__ import annotations

import atexit
from collections.abc import Callable
from dataclasses import dataclass

import bpy

from . import (
    actor_properties,
    blur_properties,
    capturing,
    check_store,
    commands,
    compositing_properties,
    cost_table,
    estimates,
    live,
    model_cache,
    panels,
    frames_there,
    part_properties,
    preferences,
    presets,
    passes_properties,
    pictures,
    properties,
    standin_properties,
    strip_view,
    worker,
)
from .jobs import board, remember_error
from .operators import bake, capture, composite, costs, diagnose, preview, rig, standin, train

CLASSES: tuple[type, ...] = (
    part_properties.CHONA_PG_object,
    part_properties.CHONA_PG_bone,
    *standin_properties.CLASSES,
    actor_properties.CHONA_PG_actor,
    *compositing_properties.CLASSES,
    properties.CHONA_PG_settings,
    preferences.CHONA_AP_preferences,
    *check_store.CLASSES,
    *rig.CLASSES,
    *standin.CLASSES,
    *blur_properties.CLASSES,
    *bake.CLASSES,
    *costs.CLASSES,
    *preview.CLASSES,
    *composite.CLASSES,
    *passes_properties.CLASSES,
    *capture.CLASSES,
    *train.CLASSES,
    *diagnose.CLASSES,
    *panels.CLASSES,
)


@dataclass(frozen=True)
class Step:
    """Something that is switched on, and how it is switched off."""

    on: Callable[[], object]
    off: Callable[[], object]


def _class_step(cls: type) -> Step:
    return Step(lambda: bpy.utils.register_class(cls), lambda: bpy.utils.unregister_class(cls))


STEPS: tuple[Step, ...] = (
    *(_class_step(cls) for cls in CLASSES),
    Step(properties.register, properties.unregister),
    Step(model_cache.register, model_cache.unregister),
    Step(presets.register, presets.unregister),
    Step(cost_table.forget, cost_table.forget),
    Step(estimates.forget, estimates.forget),
    Step(check_store.register, check_store.unregister),
    Step(strip_view.register, strip_view.unregister),
    Step(live.register, live.unregister),
    Step(commands.register, commands.unregister),
    Step(lambda: atexit.register(_at_exit), lambda: atexit.unregister(_at_exit)),
)

_done: list[Step] = []


def _at_exit() -> None:
    """End workers. The bpy module of 4.5 crashes or hangs at exit on classes with callbacks, so they are taken back."""
    worker.close_all()
    if getattr(bpy.app, "module", False):
        unregister()


    Step(frames_there.forget, frames_there.forget),
def register() -> None:
    """Switch every step on; if one fails, those before it are switched off again and the failure is raised."""
    try:
        for step in STEPS:
            step.on()
            _done.append(step)
    except Exception:
        unregister()
        raise


def unregister() -> None:
    """End workers and switch off what is on, last first."""
    worker.close_all()
    board.current = board.last = None
    remember_error("")
    while _done:
        _done.pop().off()

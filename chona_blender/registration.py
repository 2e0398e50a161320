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
    frames_there,
    jobs,
    live,
    looking,
    model_cache,
    panels,
    part_properties,
    passes_properties,
    pick_up,
    pictures,
    preferences,
    presets,
    properties,
    ring_view,
    standin_properties,
    strip_view,
    train_data,
    train_queue,
    train_rows,
    worker,
    worker_setup,
)
from .operators import bake, capture, composite, costs, diagnose, preview, rig, setup_worker, standin, train
from .operators import pick_up as pick_up_operators
from .operators import train_data as train_data_operators

CLASSES: tuple[type, ...] = (
    part_properties.CHONA_PG_object,
    part_properties.CHONA_PG_bone,
    *standin_properties.CLASSES,
    actor_properties.CHONA_PG_actor,
    *blur_properties.CLASSES,
    *compositing_properties.CLASSES,
    *passes_properties.CLASSES,
    properties.CHONA_PG_settings,
    preferences.CHONA_AP_preferences,
    *check_store.CLASSES,
    *rig.CLASSES,
    *standin.CLASSES,
    *bake.CLASSES,
    *costs.CLASSES,
    *preview.CLASSES,
    *composite.CLASSES,
    *capture.CLASSES,
    *train_rows.CLASSES,
    *train.CLASSES,
    *pick_up_operators.CLASSES,
    *train_data_operators.CLASSES,
    *diagnose.CLASSES,
    *setup_worker.CLASSES,
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
    Step(looking.forget, looking.forget),
    Step(model_cache.register, model_cache.unregister),
    Step(presets.register, presets.unregister),
    Step(cost_table.forget, cost_table.forget),
    Step(estimates.forget, estimates.forget),
    Step(frames_there.forget, frames_there.forget),
    Step(check_store.register, check_store.unregister),
    Step(strip_view.register, strip_view.unregister),
    Step(ring_view.register, ring_view.unregister),
    Step(capturing.forget, capturing.forget),
    Step(pictures.register, pictures.unregister),
    Step(train_data.forget, train_data.forget),
    Step(train_rows.register, train_rows.unregister),
    Step(train_queue.forget, train_queue.forget),
    Step(pick_up.register, pick_up.unregister),
    Step(live.register, live.unregister),
    Step(worker_setup.refresh, worker_setup.forget),
    Step(commands.register, commands.unregister),
    Step(lambda: atexit.register(_at_exit), lambda: atexit.unregister(_at_exit)),
)

_done: list[Step] = []


def _at_exit() -> None:
    """End workers. The bpy module of 4.5 crashes or hangs at exit on classes with callbacks, so they are taken back."""
    worker.close_all()
    if getattr(bpy.app, "module", False):
        unregister()


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
    jobs.end()
    worker.close_all()
    while _done:
        _done.pop().off()

"""Check for the scene's settings: everybody as they are set, also where something is missing."""

from __future__ import annotations

import bpy

from . import actions, check_store, strip_view
from .errors import ChonaError
from .rig.cast import ActorPlan
from .rig.check import Report, check


def plans_to_check(scene: bpy.types.Scene) -> list[ActorPlan]:
    """Plans of the actors that are rendered; what they lack is left to the check.

    Raises:
        ChonaError: there is none, or a model that cannot be read.
    """
    plans = [actions.plan_as_set(actor) for actor in scene.chona.used_actors()]
    if not plans:
        raise ChonaError("there is no actor to check; choose a model file, and switch an actor on")
    return plans


def run_check(scene: bpy.types.Scene) -> Report:
    """Check the scene's actors over the bake's frames, and show the result in the list and in the strips.

    Raises:
        ChonaError: there are no actors or no frames.
    """
    report = check(scene, plans_to_check(scene), scene.chona.frames())
    check_store.keep(scene, report)
    strip_view.redraw()
    return report

"""The options of Composite from what the scene's settings say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from .compositing import CompositeOptions
from .compositing_front import Figure
from .compositing_properties import REFINED

if TYPE_CHECKING:
    from .actor_properties import CHONA_PG_actor


def options_of(scene: bpy.types.Scene) -> CompositeOptions:
    """What the panel's settings ask for."""
    given = scene.chona.composite
    return CompositeOptions(given.edges == REFINED, given.shadows, given.cryptomatte, figure_of(scene))


def figure_of(scene: bpy.types.Scene) -> Figure | None:
    """Where the scene's actors are: at the first one's hips, or object, with the stand-ins of all of them.

    A stand-in that the user chose counts instead of the actors' own.
    """
    chosen = scene.chona.composite.stand_in
    actors = [actor for actor in scene.chona.actors if actor.use]
    stand_ins = [chosen] if chosen is not None else [item for actor in actors for item in actor.stand_in.present()]
    place, bone = next((found for found in map(_place, actors) if found[0] is not None), (chosen, ""))
    return None if place is None else Figure(place, bone, tuple(stand_ins))


def _place(actor: CHONA_PG_actor) -> tuple[bpy.types.Object | None, str]:
    """What tells how far an actor is."""
    if actor.armature is not None and actor.person:
        named = (item.target or item.found.partition(", ")[0] for item in actor.bones)
        bones = actor.armature.pose.bones
        return actor.armature, next((name for name in named if name in bones), bones[0].name if bones else "")
    return next((item.empty for item in actor.used_objects() if item.empty is not None), None), ""

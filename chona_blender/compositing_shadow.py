"""Lets stand-ins cast the figure's shadow and show in mirrors without being seen themselves.

The camera does not see them, so neither the picture nor its depth holds them. What was set before is kept on the
object and put back when no layer needs it any more.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING

import bpy

if TYPE_CHECKING:
    from .standin_properties import CHONA_PG_stand_in

KEPT = "chona_shadow_kept"
CASTER = {
    "hide_render": False,
    "visible_camera": False,
    "visible_shadow": True,
    "visible_glossy": True,
    "visible_diffuse": True,
    "visible_transmission": True,
    "is_holdout": False,
    "is_shadow_catcher": False,
}


def cast_shadows(items: Iterable[bpy.types.Object], name: str) -> None:
    """Make the objects casters for the layer `name`."""
    casters = list(items)
    for item in casters:  # all of them first: an actor's setting changes all its stand-ins
        kept = json.loads(item.get(KEPT, "{}")) or _now(item)
        kept["layers"] = sorted({*kept["layers"], name})
        item[KEPT] = json.dumps(kept)
    for item in casters:
        for settings in _settings(item):
            settings.use = "SHADOW"
        for key, value in CASTER.items():
            setattr(item, key, value)


def stop_shadows(name: str, staying: Iterable[bpy.types.Object] = ()) -> None:
    """Let all objects but those that stay be what they were before the layer `name` used them."""
    stays = set(staying)
    freed = []
    for item in bpy.data.objects:
        if KEPT not in item or item in stays:
            continue
        kept = json.loads(item[KEPT])
        kept["layers"] = [layer for layer in kept["layers"] if layer != name]
        if kept["layers"]:
            item[KEPT] = json.dumps(kept)
        else:
            del item[KEPT]
            freed.append((item, kept))
    for item, kept in freed:
        for settings in _settings(item):
            settings.use = kept["use"]
    for item, kept in freed:
        for key, value in kept["flags"].items():
            setattr(item, key, value)


def _now(item: bpy.types.Object) -> dict:
    return {
        "layers": [],
        "flags": {key: getattr(item, key) for key in CASTER},
        "use": next((settings.use for settings in _settings(item)), ""),
    }


def _settings(item: bpy.types.Object) -> list[CHONA_PG_stand_in]:
    """Settings of the actors whose stand-in the object is, for their panel to say what is so."""
    scenes = (scene for scene in bpy.data.scenes if hasattr(scene, "chona"))  # usable without the add-on switched on
    actors = (actor for scene in scenes for actor in scene.chona.actors)
    return [actor.stand_in for actor in actors if any(part.object == item for part in actor.stand_in.parts)]

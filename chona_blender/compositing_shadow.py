"""Lets stand-ins cast the figure's shadow and show in mirrors without being seen themselves.

The camera does not see them, so neither the picture nor its depth holds them. What was set before is kept on the
object and put back when no layer needs it any more.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

import bpy

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
    for item in items:
        kept = json.loads(item.get(KEPT, "{}")) or {"layers": [], "flags": {key: getattr(item, key) for key in CASTER}}
        kept["layers"] = sorted({*kept["layers"], name})
        item[KEPT] = json.dumps(kept)
        for key, value in CASTER.items():
            setattr(item, key, value)


def stop_shadows(name: str, staying: Iterable[bpy.types.Object] = ()) -> None:
    """Let all objects but those that stay be what they were before the layer `name` used them."""
    stays = set(staying)
    for item in bpy.data.objects:
        if KEPT not in item or item in stays:
            continue
        kept = json.loads(item[KEPT])
        kept["layers"] = [layer for layer in kept["layers"] if layer != name]
        if kept["layers"]:
            item[KEPT] = json.dumps(kept)
            continue
        del item[KEPT]
        for key, value in kept["flags"].items():
            setattr(item, key, value)


def casts(name: str) -> bool:
    """Whether an object casts shadows for the layer `name`."""
    return any(name in json.loads(item[KEPT])["layers"] for item in bpy.data.objects if KEPT in item)

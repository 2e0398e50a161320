"""Registers and unregisters the add-on again and again and tells what is left behind; describes every operator."""

from __future__ import annotations

import bpy
from operation_scene import say

import chona_blender
from chona_blender import registration


def traces() -> list[str]:
    """Everything that the add-on puts into Blender."""
    found = [name for name in dir(bpy.types) if name.startswith("CHONA_")]
    found += [cls.__name__ for cls in registration.CLASSES if cls.is_registered]
    found += [f"bpy.ops.chona.{name}" for name in dir(bpy.ops.chona) if hasattr(bpy.types, f"CHONA_OT_{name}")]
    found += ["Scene.chona"] if hasattr(bpy.types.Scene, "chona") else []
    for handlers in (bpy.app.handlers.load_post, bpy.app.handlers.frame_change_post, bpy.app.handlers.render_pre):
        found += [repr(handler) for handler in handlers if "chona" in handler.__module__]
    return found


clean = traces()
rounds = []
for _ in range(3):
    chona_blender.register()
    rounds.append(len(traces()))
    chona_blender.unregister()
    rounds.append(len(traces()))

# A step that fails halfway: everything before it is taken back, and a panel with the reason stands in.
broken = registration.Step(lambda: 1 / 0, lambda: None)
steps = registration.STEPS
registration.STEPS = (*steps[:10], broken, *steps[10:])
chona_blender.register()
after_failure = traces()
chona_blender.unregister()
after_failure_off = traces()
registration.STEPS = steps

chona_blender.register()
operators = {}
for name in sorted(dir(bpy.types)):
    if name.startswith("CHONA_OT_"):
        cls = getattr(bpy.types, name)
        rna = getattr(bpy.ops.chona, cls.bl_idname.partition(".")[2]).get_rna_type()
        properties = [p for p in rna.properties if p.identifier != "rna_type"]
        operators[cls.bl_idname] = {
            "tooltip": rna.description,
            "untold": [p.identifier for p in properties if not p.description],
            "poll": "poll" in vars(cls),
        }
untold = [
    f"{cls.__name__}.{p.identifier}"
    for cls in registration.CLASSES[:3]
    for p in cls.bl_rna.properties
    if p.identifier not in {"rna_type", "bl_idname"} and not p.description and p.identifier != "objects"
]
say(
    {
        "clean": clean,
        "rounds": rounds,
        "after_failure": after_failure,
        "after_failure_off": after_failure_off,
        "operators": operators,
        "untold": untold,
    }
)

"""Runs inside the real Blender with a window: a Mixamo rig is mapped, checked and shown, with numbered pictures.

Not collected by pytest. `blender --python-use-system-env --python rig_gui.py -- MODEL FOLDER`, with the repository and
this folder on $PYTHONPATH; MODEL has SMPL's skeleton and, for the strip, a record of its training poses.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path

import bpy
from rig_bodies import RIGS, build

import chona_blender
from chona_blender import check_store
from chona_blender.panels.rig import CHONA_PT_bones

model, out = (Path(part) for part in sys.argv[sys.argv.index("--") + 1 :][:2])
answer: dict = {"version": list(bpy.app.version)}


def view_area() -> bpy.types.Area:
    """The 3D view of the first window."""
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "VIEW_3D")


def call(operator: str, **options: object) -> set[str]:
    """An operator as a click in the sidebar would call it."""
    area = view_area()
    region = next(each for each in area.regions if each.type == "UI")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=region):
        return getattr(bpy.ops.chona, operator)("EXEC_DEFAULT", **options)


def redraw(times: int = 4) -> Iterator[float]:
    """Panels slide to their places over several redraws."""
    for _ in range(times):
        for area in bpy.context.window_manager.windows[0].screen.areas:
            area.tag_redraw()
        yield 0.3


def picture(name: str) -> Iterator[float]:
    """A picture of the whole screen."""
    yield from redraw()
    subprocess.run(["scrot", "-o", str(out / f"{name}.png")], check=True)


def wave(rig: bpy.types.Object) -> None:
    """Forty-eight frames: an arm goes up behind the head, and a knee bends further than people's."""
    keys = (
        ("LeftArm", 2, {1: 0.0, 24: 1.3, 48: 0.0}), ("LeftForeArm", 2, {1: 0.0, 24: 0.9, 48: 0.2}),
        ("RightLeg", 0, {1: 0.0, 20: 0.2, 36: 2.9, 48: 0.1}), ("Spine1", 1, {1: 0.0, 30: 0.4}),
    )  # fmt: skip
    for name, axis, values in keys:
        bone = rig.pose.bones[name]
        bone.rotation_mode = "XYZ"
        for frame, value in values.items():
            bone.rotation_euler[axis] = value
            bone.keyframe_insert("rotation_euler", frame=frame)
    bone = rig.pose.bones["RightArm"]
    for frame, value in ((1, 1.0), (40, 1.0), (44, 1.2)):
        bone.scale = (value, 1.0, 1.0)
        bone.keyframe_insert("scale", frame=frame)


def story() -> Iterator[float]:
    """What an animator does."""
    for name in ("Cube", "Light"):
        bpy.data.objects.remove(bpy.data.objects[name])
    scene = bpy.context.scene
    scene.frame_end = 48
    rig = build(RIGS["mixamo A-pose"])
    rig.location.z = 0.1
    wave(rig)
    area = view_area()
    area.spaces.active.show_region_ui = True
    space = area.spaces.active.region_3d
    space.view_location, space.view_distance = (0.3, 0.0, 0.9), 3.6
    space.view_rotation = (0.78, 0.58, 0.13, 0.18)
    yield 0.5
    region = next(each for each in area.regions if each.type == "UI")
    region.active_panel_category = "CHONA"
    yield from picture("1_nothing")
    scene.chona.first_model = str(model)
    yield from picture("2_model")
    scene.chona.armature = rig
    answer["mapped"] = list(call("map_rig"))
    answer["family"] = scene.chona.actor.family
    scene.chona.actor.bones["head"].target = "Neck"
    scene.chona.actor.bones["left_wrist"].target = "(parent)"
    scene.frame_set(30)
    yield from picture("3_mapped")
    call("map_rig")
    answer["checked"] = list(call("check"))
    answer["findings"] = [finding.words for finding in check_store.report_of(scene).findings]
    shown = bpy.context.window_manager.chona_findings
    shown.active = next((i for i, row in enumerate(shown.rows) if "further" in row.name), 0)
    yield from picture("4_checked")
    answer["shown"] = list(call("show_finding", index=shown.active))
    answer["frame"] = scene.frame_current
    yield from picture("5_shown")
    bpy.utils.unregister_class(CHONA_PT_bones)  # room for the whole of Check
    yield from picture("5_check_alone")
    bpy.ops.object.mode_set(mode="OBJECT")
    call("actor_add")
    scene.chona.armature = None
    call("create_rig")
    scene.chona.armature.location.x = 1.2
    yield from picture("6_two_actors")
    answer["actors"] = [actor.label for actor in scene.chona.actors]


steps = story()


def step() -> float | None:
    """One step of the story; a failure ends Blender with its words in the answer."""
    try:
        return next(steps)
    except StopIteration:
        code = 0
    except Exception:
        answer["failure"] = traceback.format_exc()
        code = 9
    (out / "answer.json").write_text(json.dumps(answer, indent=1))
    os._exit(code)


CHONA_PT_bones.bl_options = set()  # open, for the picture
chona_blender.register()
bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(step, first_interval=1.0)

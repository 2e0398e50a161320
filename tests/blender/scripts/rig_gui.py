"""Runs inside the real Blender with a window: a Mixamo rig is mapped, checked and shown, with numbered pictures.

Not collected by pytest. `blender --python-use-system-env --python rig_gui.py -- MODEL FOLDER`, with the repository and
this folder on $PYTHONPATH; MODEL has SMPL's skeleton and, for the strip, a record of its training poses.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
from rig_bodies import RIGS, build
from window import Drive, call, show_sidebar, view_area

import chona_blender
from chona_blender import check_store
from chona_blender.panels.rig import CHONA_PT_bones

model, out = (Path(part) for part in sys.argv[sys.argv.index("--") + 1 :][:2])
drive = Drive(out, {"version": list(bpy.app.version)})
answer = drive.answer


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
    space = view_area().spaces.active.region_3d
    space.view_location, space.view_distance = (0.3, 0.0, 0.9), 3.6
    space.view_rotation = (0.78, 0.58, 0.13, 0.18)
    yield from show_sidebar()
    yield from drive.picture("nothing")
    scene.chona.first_model = str(model)
    yield from drive.picture("model")
    scene.chona.armature = rig
    answer["mapped"] = call("chona.map_rig", "EXEC_DEFAULT")
    answer["family"] = scene.chona.actor.family
    scene.chona.actor.bones["head"].target = "Neck"
    scene.chona.actor.bones["left_wrist"].target = "(parent)"
    scene.frame_set(30)
    yield from drive.picture("mapped")
    call("chona.map_rig", "EXEC_DEFAULT")
    answer["checked"] = call("chona.check", "EXEC_DEFAULT")
    answer["findings"] = [finding.words for finding in check_store.report_of(scene).findings]
    shown = bpy.context.window_manager.chona_findings
    shown.active = next((i for i, row in enumerate(shown.rows) if "further" in row.name), 0)
    yield from drive.picture("checked")
    answer["shown"] = call("chona.show_finding", "EXEC_DEFAULT", index=shown.active)
    answer["frame"] = scene.frame_current
    yield from drive.picture("shown")
    bpy.utils.unregister_class(CHONA_PT_bones)  # room for the whole of Check
    yield from drive.picture("check_alone")
    bpy.ops.object.mode_set(mode="OBJECT")
    call("chona.actor_add", "EXEC_DEFAULT")
    scene.chona.armature = None
    call("chona.create_rig", "EXEC_DEFAULT")
    scene.chona.armature.location.x = 1.2
    yield from drive.picture("two_actors")
    answer["actors"] = [actor.label for actor in scene.chona.actors]


CHONA_PT_bones.bl_options = set()  # open, for the picture
chona_blender.register()
drive.run(story())

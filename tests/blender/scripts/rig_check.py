"""Works on the rig's panels as an animator would: maps, chooses bones, saves a preset, checks, goes to findings.

Arguments: a model with a record of its training poses, one without. Presets go to $BLENDER_USER_RESOURCES.
"""

from __future__ import annotations

import sys

import bpy
from operation_scene import empty_scene, say

import chona_blender
from chona_blender import check_store, strip_view
from chona_blender.actions import actor_plans
from chona_blender.operators.rig import CHONA_MT_rig_presets
from chona_blender.shot import sample_actors

model, silent = sys.argv[1:3]
chona_blender.register()
BONES = {
    "pelvis": "Hips", "spine": "Spine1", "neck": "Neck", "head": "Head", "left_hip": "LeftUpLeg",
    "left_knee": "LeftLeg", "left_ankle": "LeftFoot", "left_shoulder": "LeftArm", "left_elbow": "LeftForeArm",
    "left_wrist": "LeftHand",
}  # fmt: skip


def scene_with_rig(path: str) -> tuple[bpy.types.Scene, bpy.types.Object]:
    """The model's rig with its bones renamed as Mixamo's, three frames."""
    scene = empty_scene()
    scene.frame_end = 3
    scene.chona.model_path = path
    bpy.ops.chona.create_rig()
    armature = scene.chona.armature
    for old, new in BONES.items():
        armature.data.bones[old].name = new
        if old.startswith("left_"):
            armature.data.bones[old.replace("left_", "right_")].name = new.replace("Left", "Right")
    scene.chona.actor.refresh_bones()
    return scene, armature


def key(bone: bpy.types.PoseBone, channel: str, values: dict[int, object]) -> None:
    """Keys of one channel."""
    bone.rotation_mode = "XYZ"
    for frame, value in values.items():
        setattr(bone, channel, value)
        bone.keyframe_insert(channel, frame=frame)


def findings(scene: bpy.types.Scene) -> list[list]:
    """What Check says."""
    bpy.ops.chona.check()
    return [[f.kind, f.bone, f.frame, f.words] for f in check_store.report_of(scene).findings]


def mapping() -> dict:
    """Recognised, chosen, wrong, and as a preset."""
    scene, armature = scene_with_rig(model)
    actor = scene.chona.actor
    bpy.ops.chona.map_rig()
    answer = {"family": actor.family, "rows": {b.name: [b.target, b.found, b.state] for b in actor.bones}}
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="POSE")
    armature.data.bones.active = armature.data.bones["Neck"]
    actor.active_bone = [b.name for b in actor.bones].index("head")
    bpy.ops.chona.bone_pick()
    actor.bones["left_wrist"].target = "(parent)"
    answer["picked"] = [actor.bones["head"].found, actor.bones["left_wrist"].state]
    answer["saved"] = list(bpy.ops.chona.rig_preset_add(name="My rig"))
    bpy.ops.chona.map_rig()
    answer["recognised again"] = [actor.bones["head"].found, actor.bones["left_wrist"].found]
    path = bpy.utils.preset_find("My_rig", "chona/rig") or bpy.utils.preset_find("My rig", "chona/rig")
    bpy.ops.script.execute_preset(filepath=path, menu_idname=CHONA_MT_rig_presets.__name__)
    answer["loaded"] = [actor.bones["head"].found, actor.bones["left_wrist"].state, actor.bones["left_hip"].found]
    answer["removed"] = list(bpy.ops.chona.rig_preset_add(remove_active=True))
    answer["left"] = bpy.utils.preset_find("My_rig", "chona/rig") or ""
    armature.data.bones["LeftLeg"].name = "cheese"
    bpy.ops.chona.map_rig()
    answer["missing"] = [actor.family, actor.bones["left_knee"].state, actor.bones[actor.active_bone].name]
    answer["unmapped"] = findings(scene)
    bpy.ops.object.mode_set(mode="OBJECT")
    return answer


def wrong() -> dict:
    """One of everything that Check tells, and the way there."""
    scene, armature = scene_with_rig(model)
    armature.location.x = 0.4
    pose = armature.pose.bones
    answer = {"good": findings(scene)}
    key(pose["LeftForeArm"], "scale", {1: (1, 1, 1), 2: (1.3, 1.0, 1.0), 3: (1, 1, 1)})
    key(pose["RightForeArm"], "scale", {1: (1.05, 1.05, 1.05)})
    key(pose["RightLeg"], "scale", {1: (1, 1, 1), 2: (1, 1, 1), 3: (0, 0, 0)})
    key(pose["Head"], "rotation_euler", {1: (0, 0, 0), 2: (0, 0, 0), 3: (1.5, 0, 0)})
    answer["wrong"] = findings(scene)
    scene.frame_set(1)
    shown = bpy.context.window_manager.chona_findings
    rows = [f.bone for f in check_store.report_of(scene).findings]
    answer["rows"] = [row.name for row in shown.rows]
    bpy.ops.chona.show_finding(index=rows.index("LeftForeArm"))
    chosen = [b.name for b in pose if (b.select if hasattr(b, "select") else b.bone.select)]
    answer["shown"] = [scene.frame_current, armature.mode, chosen, armature.data.bones.active.name]
    bpy.ops.object.mode_set(mode="OBJECT")
    return answer


def strips() -> dict:
    """The strip over three frames of which the last is far from the training."""
    scene, armature = scene_with_rig(model)
    key(armature.pose.bones["LeftLeg"], "rotation_euler", {1: (0, 0, 0), 2: (0.2, 0, 0), 3: (2.4, 0, 0)})
    told = findings(scene)
    (strip,) = check_store.report_of(scene).strips
    paint = strip_view.colours(strip.level).tolist()
    points, corners = strip_view.corners(strip)
    answer = {"level": strip.level.tolist(), "words": strip.words, "told": told, "paint": paint}
    answer["corners"] = [len(points), len(corners), min(p[0] for p in points), max(p[0] for p in points)]
    scene, _ = scene_with_rig(silent)
    findings(scene)
    (strip,) = check_store.report_of(scene).strips
    return answer | {"silent": [strip.words, len(strip.frames)]}


def several() -> dict:
    """Two people and a lone object, one of another model, in one shot; one that is switched off."""
    scene, armature = scene_with_rig(model)
    first = scene.chona.actor
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = None
    bpy.ops.chona.actor_add()
    scene.chona.person = "Robin"
    bpy.ops.chona.create_rig()
    second = scene.chona.actor
    second.armature.location.x = 1.5
    bpy.ops.chona.actor_add()
    third = scene.chona.actor
    third.model_path = silent
    bpy.ops.chona.choose_person(person="(nobody)")
    bpy.ops.chona.object_add(object="crate")
    shot = sample_actors(scene, actor_plans(scene), [1, 2])
    names = [[a["name"], a["person"], a["objects"], "model" in a] for a in shot.header["actors"]]
    apart = shot.arrays["actor.1.world_from_bone"][0, 0, :3, 3] - shot.arrays["actor.0.world_from_bone"][0, 0, :3, 3]
    second.use = False
    fewer = len(sample_actors(scene, actor_plans(scene), [1]).header["actors"])
    del first, third
    bpy.ops.chona.actor_remove()
    return {
        "names": names, "apart": apart.tolist(), "fewer": fewer, "left": len(scene.chona.actors),
        "same armature": armature == scene.chona.actors[0].armature,
    }  # fmt: skip


def polls() -> dict:
    """Why buttons are off."""
    scene = empty_scene()
    answer = {}
    for name in ("map_rig", "bone_pick", "check", "show_finding", "create_rig", "object_add", "object_remove"):
        try:
            getattr(bpy.ops.chona, name)()
        except RuntimeError as error:
            answer[name] = str(error)
    scene.chona.first_model = model
    answer["first model"] = [len(scene.chona.actors), scene.chona.model_path == model, scene.chona.first_model]
    return answer


say({"mapping": mapping(), "wrong": wrong(), "strips": strips(), "several": several(), "polls": polls()})

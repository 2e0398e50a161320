"""How far stand-ins on rigs of many families are from the model's own forward skinning of the same frames.

Argument: a folder for files.
"""

from __future__ import annotations

import os
import sys
from math import radians
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix
from operation_scene import say
from rig_bodies import RIGS, SMPL, animate, build
from stand_in_bodies import JOINTS, body, crate, evaluated, put_together, skinned, write_model, write_stand_in

import chona_blender
from chona_blender import actions
from chona_blender.errors import ChonaError
from chona_blender.rig.cast import cast
from chona_blender.rig.sampling import sample
from chona_blender.standin_file import read_stand_in

FOLDER = Path(sys.argv[1])
FRAMES = (1, 2, 3, 4)
chona_blender.register()
MODEL = write_model(FOLDER / "model.safetensors")
FILE = write_stand_in(FOLDER / "stand-in.npz", {"Robin": body()})
BOTH = write_stand_in(FOLDER / "both.npz", {"Robin": body(), "crate": crate()})


def fresh() -> bpy.types.Scene:
    """An empty file whose actor is Robin."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.chona.model_path = str(MODEL)
    return scene


def measure(scene: bpy.types.Scene, follow: str = "RIG") -> dict:
    """Metres between evaluated vertices and forward skinning over the frames, and how far vertices have moved."""
    actor = scene.chona.actor
    actor.stand_in.follow = follow
    mesh = put_together(scene, FILE)[0]
    part = read_stand_in(FILE, len(SMPL))[0]
    driver = cast(actions.actor_plan(actor)).driver
    pose = driver.pose(sample(scene, actor.armature, driver.bones, [], frames=FRAMES), [], limit=0.1, object_limit=0.1)
    away, moved, first = [], [], None
    for index, frame in enumerate(FRAMES):
        scene.frame_set(frame)
        found = evaluated(mesh)
        away.append(np.linalg.norm(found - pose.scale * skinned(pose.world_from_bone[index], part), axis=1))
        first = found if first is None else first
        moved.append(np.linalg.norm(found - first, axis=1).max())
    away = np.array(away)
    return {
        "largest": float(away.max()), "mean": float(away.mean()), "moved": float(max(moved)), "scale": pose.scale,
        "worst": sorted(zip(away.max(axis=0).reshape(-1, 30).max(axis=1).tolist(), SMPL, strict=True))[-3:],
        "groups": len(mesh.vertex_groups), "missing": [g.name for g in mesh.vertex_groups
                                                       if g.name not in actor.armature.data.bones],
    }  # fmt: skip


def own_rig() -> dict:
    """The rig that the add-on makes, every bone turned at random."""
    scene = fresh()
    bpy.ops.chona.create_rig()
    item = scene.chona.armature
    random = np.random.default_rng(5)
    for frame in FRAMES:
        for bone in item.pose.bones:
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = random.normal(0.0, 0.5, 3)
            bone.keyframe_insert("rotation_euler", frame=frame)
        item.location = random.normal(0.0, 1.0, 3)
        item.keyframe_insert("location", frame=frame)
    return measure(scene)


def family(name: str, transform: Matrix | None = None, follow: str = "RIG") -> dict:
    """A rig of a family as its makers deliver it, with the model's proportions and rolls at random."""
    scene = fresh()
    item = build(RIGS[name])
    if transform is not None:
        item.matrix_world = transform @ item.matrix_basis
    animate(item, RIGS[name])
    scene.chona.armature = item
    return measure(scene, follow)


def rigify() -> dict:
    """Rigify's own generated rig, posed by its controls; its body is another."""
    scene = fresh()
    bpy.ops.preferences.addon_enable(module="rigify")
    bpy.ops.object.armature_basic_human_metarig_add()
    bpy.ops.pose.rigify_generate()
    item = next(each for each in bpy.data.objects if each.type == "ARMATURE" and "root" in each.data.bones)
    random = np.random.default_rng(3)
    for frame in FRAMES:
        for name in ("torso", "chest", "hand_ik.L", "hand_ik.R", "foot_ik.L", "head"):
            bone = item.pose.bones[name]
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = random.normal(0.0, radians(15.0), 3)
            bone.keyframe_insert("rotation_euler", frame=frame)
            bone.location = random.normal(0.0, 0.05, 3)
            bone.keyframe_insert("location", frame=frame)
    scene.chona.armature = item
    return {follow: measure(scene, follow) for follow in ("RIG", "FIGURE")}


def refused() -> dict:
    """Armatures that cannot carry a mesh are refused by name."""
    answer = {}
    scene = fresh()
    bpy.ops.chona.create_rig()
    item = scene.chona.armature
    item.data.bones["left_knee"].use_deform = False
    for case, change in (
        ("no deform", lambda: None),
        ("mirrored", lambda: setattr(item, "scale", (-1.0, 1.0, 1.0))),
        ("flat", lambda: setattr(item, "scale", (1.0, 1.0, 0.0))),
    ):
        change()
        bpy.context.view_layer.update()
        try:
            put_together(scene, FILE)
            answer[case] = "made"
        except ChonaError as error:
            answer[case] = str(error)
        item.data.bones["left_knee"].use_deform = True
    return answer | {"meshes": len(bpy.data.meshes)}


def objects() -> dict:
    """The object's mesh against its frame: with a scaled figure, and alone on a scaled, turned empty."""
    corners = np.array(read_stand_in(BOTH, len(SMPL))[1].vertices)
    answer = {}
    scene = fresh()
    bpy.ops.chona.create_rig()
    actor = scene.chona.actor
    actor.armature.scale = (1.5,) * 3
    empty = actor.objects[0].empty
    empty.location, empty.rotation_euler, empty.scale = (0.3, -0.7, 1.1), (1.0, 0.5, -0.3), (1.5,) * 3
    bpy.context.view_layer.update()
    crate_mesh = put_together(scene, BOTH)[1]
    rotation, place = np.array(empty.matrix_world.to_3x3().normalized()), np.array(empty.matrix_world.translation)
    answer["scaled"] = float(np.abs(evaluated(crate_mesh) - (1.5 * corners @ rotation.T + place)).max())
    empty.location.x += 1.0
    bpy.context.view_layer.update()
    answer["moved"] = float(evaluated(crate_mesh)[:, 0].mean() - place[0])
    scene = fresh()
    scene.chona.person = ""
    bpy.ops.chona.object_add(object="crate")
    empty = scene.chona.actor.objects[0].empty
    empty.location = (2.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    alone = write_stand_in(FOLDER / "alone.npz", {"crate": crate()})
    made = put_together(scene, alone)
    rotation = np.array(empty.matrix_world.to_3x3())
    expected = corners @ rotation.T + np.array(empty.matrix_world.translation)
    answer["alone"] = float(np.abs(evaluated(made[0]) - expected).max())
    answer["modifiers"] = len(made[0].modifiers)
    return answer


answer = {"own": own_rig(), "families": {name: family(name) for name in RIGS}}
turned = Matrix.Translation((2, -3, 1)) @ Matrix.Rotation(2.0, 4, "Z") @ Matrix.Rotation(0.3, 4, "X")
answer["figures"] = {name: family(name, None, "FIGURE") for name in RIGS}
answer["turned"] = family("mixamo A-pose", turned)
answer["giant"] = family("unreal", Matrix.Scale(5.0, 4))
answer["refused"] = refused()
answer["objects"] = objects()
answer["joints"] = len(JOINTS)
answer["rigify"] = rigify()
say(answer)
sys.stdout.flush()
os._exit(0)  # with Rigify enabled the bpy module of 4.5 hangs where it would end

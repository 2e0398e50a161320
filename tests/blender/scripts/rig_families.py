"""Poses armatures of every rig family at random and tells how far a model's joints are from the animator's.

Argument: a folder for a library file.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from math import radians
from pathlib import Path

import bpy
import numpy as np
from bpy.types import Object
from mathutils import Matrix, Vector
from operation_scene import say
from rig_bodies import RIGS, SMPL, SMPL_PARENTS, animate, build, rows_of, smpl_joints

from chona_blender.rig.driver import Driver, make_driver
from chona_blender.rig.retarget import NATURAL_SIZE
from chona_blender.rig.sampling import sample

FRAMES = (1, 2, 3, 4)
JOINTS = smpl_joints()
SEEN = {name: index for index, name in enumerate(SMPL)}


def fresh() -> None:
    """An empty file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)


def measure(item: Object, driver: Driver) -> dict:
    """Largest distances over the frames between the model's joints and the heads of the armature's bones, metres."""
    samples = sample(bpy.context.scene, item, driver.bones, [], frames=FRAMES)
    pose = driver.pose(samples, [], limit=0.1, object_limit=0.1)
    found: dict[str, float] = {}
    palms = [0.0]
    for frame, at in enumerate(FRAMES):
        bpy.context.scene.frame_set(at)
        bpy.context.view_layer.update()
        for index, name in enumerate(driver.skeleton.names):
            if driver.mapping.bones[name]:
                here = np.array(item.matrix_world @ item.pose.bones[driver.mapping.bones[name][0]].head)
                away = float(np.linalg.norm(pose.world_from_bone[frame, index, :3, 3] * pose.scale - here))
                found[name] = max(found.get(name, 0.0), away)
        for side, hand in (("L", "left_wrist"), ("R", "right_wrist")):
            fingers = [driver.mapping.rig.parts.get(f"{finger}1.{side}") for finger in ("index", "pinky")]
            if all(fingers) and hand in SEEN:
                ends = [Vector(item.matrix_world @ item.pose.bones[each[0]].head) for each in fingers]
                across = np.array((ends[0] - ends[1]).normalized())
                palms.append(float(np.degrees(np.arccos(across @ pose.world_from_bone[frame, SEEN[hand], :3, 2]))))
    return {
        "label": driver.mapping.rig.label, "away": found, "palms": max(palms), "scale": pose.scale,
        "unmapped": [name for name, bones in driver.mapping.bones.items() if not bones],
    }  # fmt: skip


def posed(item: Object, rig: str) -> dict:
    """Animated and measured with the body's own SMPL skeleton."""
    animate(item, RIGS[rig])
    return measure(item, make_driver(item, SMPL, SMPL_PARENTS, JOINTS))


def family(rig: str) -> dict:
    """One family as its makers deliver it."""
    fresh()
    return posed(build(RIGS[rig]), rig) | {"wanted": RIGS[rig].label}


def turned(rig: str) -> dict:
    """The object moved and turned."""
    fresh()
    item = build(RIGS[rig])
    item.matrix_world = (
        Matrix.Translation((2, -3, 1)) @ Matrix.Rotation(2.0, 4, "Z") @ Matrix.Rotation(0.3, 4, "X") @ item.matrix_basis
    )
    return posed(item, rig)


def parented(rig: str) -> dict:
    """Under a moving, turned and scaled parent that takes the scale back."""
    fresh()
    item = build(RIGS[rig])
    parent = bpy.data.objects.new("parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.matrix_world = Matrix.Translation((3, 2, 1)) @ Matrix.Rotation(1.0, 4, "Y") @ Matrix.Scale(2.0, 4)
    item.parent = parent
    item.scale = [each / 2.0 for each in item.scale]
    for frame in FRAMES:
        parent.location.x = frame
        parent.keyframe_insert("location", frame=frame)
    return posed(item, rig)


def facing_away(rig: str) -> dict:
    """The bones themselves turned by 180 degrees in edit mode, with rolls."""
    fresh()
    item = build(RIGS[rig])
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in item.data.edit_bones:
        bone.transform(Matrix.Rotation(np.pi, 4, "Z"), scale=False, roll=True)
    bpy.ops.object.mode_set(mode="OBJECT")
    return posed(item, rig)


def overridden(rig: str) -> dict:
    """Linked from a library and overridden, posed in the file that links it."""
    fresh()
    build(RIGS[rig])
    library = Path(sys.argv[1]) / f"{bpy.app.version_string.replace(' ', '')}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(library))
    fresh()
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.objects = ["rig"]
    linked = target.objects[0]
    bpy.context.scene.collection.objects.link(linked)
    item = linked.override_create(remap_local_usages=True)
    answer = posed(item, rig)
    return answer | {"overridden": item.override_library is not None and item.data.library is not None}


def longer() -> dict:
    """Longer limbs than the model's: directions are carried, the figure keeps its lengths, feet stay on the ground."""
    fresh()
    rig = RIGS["mixamo A-pose"]
    item = build(rig)
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in item.data.edit_bones:  # legs and arms 1.3 times as long, the rest as it is
        for side in (-1.0, 1.0):
            hip, shoulder = Vector((9.0 * side, 87.0, 1.0)), Vector((17.0 * side, 140.0, -3.0))
            for centre, words in ((hip, ("Leg", "Foot", "Toe")), (shoulder, ("Arm", "Hand"))):
                if any(word in bone.name for word in words) and ("Right" in bone.name) == (side < 0):
                    bone.head, bone.tail = (centre + 1.3 * (end - centre) for end in (bone.head, bone.tail))
    bpy.ops.object.mode_set(mode="OBJECT")
    answer = {}
    for legs in (False, True):
        driver = make_driver(item, SMPL, SMPL_PARENTS, JOINTS, legs_scale=legs)
        resting = driver.pose(
            sample(bpy.context.scene, item, driver.bones, [], frames=[1]), [], limit=0.1, object_limit=0.1
        )
        ankles = [resting.world_from_bone[0, SEEN[f"{side}_ankle"], 2, 3] for side in ("left", "right")]
        ground = [float((item.matrix_world @ item.data.bones[f"{s}Foot"].head_local).z) for s in ("Left", "Right")]
        answer["scaled" if legs else "plain"] = [float(np.mean(ankles)), float(np.mean(ground))]
    animate(item, rig)
    samples = sample(bpy.context.scene, item, driver.bones, [], frames=FRAMES)
    pose = driver.pose(samples, [], limit=0.1, object_limit=0.1)
    answer["scale"], answer["lengths"], answer["angles"] = pose.scale, 0.0, 0.0
    for frame, at in enumerate(FRAMES):
        bpy.context.scene.frame_set(at)
        for start, end in (
            ("left_shoulder", "left_elbow"),
            ("right_elbow", "right_wrist"),
            ("left_knee", "left_ankle"),
        ):
            own = pose.world_from_bone[frame, SEEN[end], :3, 3] - pose.world_from_bone[frame, SEEN[start], :3, 3]
            heads = [item.matrix_world @ item.pose.bones[driver.mapping.bones[n][0]].head for n in (start, end)]
            there = np.array((heads[1] - heads[0]).normalized())
            length = float(np.linalg.norm(JOINTS[SEEN[end]] - JOINTS[SEEN[start]]))
            answer["lengths"] = max(answer["lengths"], abs(float(np.linalg.norm(own)) - length))
            cosine = float(np.clip(own @ there / np.linalg.norm(own), -1.0, 1.0))
            answer["angles"] = max(answer["angles"], float(np.degrees(np.arccos(cosine))))
    return answer


def giant() -> dict:
    """Five times as large as people are: the figure is as large as its armature."""
    fresh()
    item = build(RIGS["unreal"])
    item.scale = [5.0 * each for each in item.scale]
    return posed(item, "unreal") | {"natural": list(NATURAL_SIZE)}


def captured() -> dict:
    """A model that was captured from a Mixamo character, driven by MPFB's default rig."""
    fresh()
    rows = [(n, p, a) for n, p, a in rows_of(replace(RIGS["mixamo"], rest=RIGS["vrm"].rest))]
    names = [name for name, _, _ in rows]
    parents = [names.index(parent) if parent else -1 for _, parent, _ in rows]
    item = build(RIGS["mpfb default"])
    animate(item, RIGS["mpfb default"])
    driver = make_driver(item, names, parents, np.array([at for _, _, at in rows]))
    return measure(item, driver) | {"model": driver.mapping.model.label}


def rigify() -> dict:
    """A rig that Rigify generates, posed by its IK controls, for a body with the metarig's proportions."""
    fresh()
    bpy.ops.preferences.addon_enable(module="rigify")
    bpy.ops.object.armature_basic_human_metarig_add()
    bpy.ops.pose.rigify_generate()
    item = next(each for each in bpy.data.objects if each.type == "ARMATURE" and "root" in each.data.bones)
    rest = {bone.name: np.array(bone.head_local) @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]] for bone in item.data.bones}
    joints = dict(zip(SMPL, JOINTS, strict=True))
    for side, letter, sign in (("left", "L", 1.0), ("right", "R", -1.0)):
        limbs = (
            (("shoulder", "upper_arm"), ("elbow", "forearm"), ("wrist", "hand")),
            (("hip", "thigh"), ("knee", "shin"), ("ankle", "foot"), ("foot", "toe")),
        )
        joints[f"{side}_collar"] = rest[f"DEF-shoulder.{letter}"]
        joints[f"{side}_hand"] = rest[f"DEF-hand.{letter}"] + (0.08 * sign, 0.0, 0.0)
        for limb, along in zip(limbs, ((sign, 0.0, 0.0), (0.0, -1.0, 0.0)), strict=True):
            heads = [rest[f"DEF-{bone}.{letter}"] for _, bone in limb]
            at = heads[0]
            for (name, _), here, after in zip(limb, heads, [*heads[1:], None], strict=True):
                joints[f"{side}_{name}"] = at
                if after is not None:
                    step = after - here
                    at = at + (step if name == "ankle" else np.linalg.norm(step) * np.array(along))
    for name, bone in (("pelvis", "spine"), ("spine1", "spine.001"), ("spine2", "spine.002"), ("spine3", "spine.003"),
                       ("neck", "spine.004"), ("head", "spine.006")):  # fmt: skip
        joints[name] = rest[f"DEF-{bone}"]
    for bone in item.pose.bones:
        if "IK_Stretch" in bone:
            bone["IK_Stretch"] = 0.0
    random = np.random.default_rng(3)
    controls = ("torso", "chest", "hips", "hand_ik.L", "hand_ik.R", "foot_ik.L", "foot_ik.R", "head", "neck")
    for frame in FRAMES:
        for name in controls:
            bone = item.pose.bones[name]
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = random.normal(0.0, radians(15.0), 3)
            bone.keyframe_insert("rotation_euler", frame=frame)
            if name.startswith(("torso", "hand", "foot")):
                bone.location = random.normal(0.0, 0.05, 3) - np.array([0.0, 0.0, 0.1 * (name == "torso")])
                bone.keyframe_insert("location", frame=frame)
    driver = make_driver(item, SMPL, SMPL_PARENTS, np.array([joints[name] for name in SMPL]))
    return measure(item, driver)


answer = {"families": {name: family(name) for name in RIGS}}
answer["turned"] = {name: turned(name) for name in ("mixamo A-pose", "unreal", "mpfb default")}
answer["parented"] = parented("mixamo A-pose")
answer["facing away"] = facing_away("mpfb game engine")
answer["overridden"] = overridden("mixamo A-pose")
answer["longer"] = longer()
answer["giant"] = giant()
answer["captured"] = captured()
answer["rigify"] = rigify()
say(answer)
sys.stdout.flush()
os._exit(0)  # with Rigify enabled the bpy module of 4.5 hangs where it would end

"""A Mixamo character with the demo's proportions that handles a crate, and the demo's room around it."""

from __future__ import annotations

from math import radians

import bpy
import numpy as np
from mathutils import Matrix, Vector
from rig_bodies import M

from demo.body import BONES, PARENTS, bone_tails, rest_joints
from demo.poses import NOVEL, performance
from demo.room import add_camera, add_lights, build_room, set_render

UNIT = 100.0
"""Mixamo's centimetres in a metre."""
PLAIN_NAMES = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head",
    "collar": "Shoulder", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand",
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase",
}  # fmt: skip


def mixamo_name(bone: str) -> str | None:
    """Mixamo's name of one of SMPL's bones; None where Mixamo has none (the hand beyond the wrist)."""
    side, _, part = bone.rpartition("_")
    name = PLAIN_NAMES.get(part)
    return None if name is None else f"{M}{side.capitalize()}{name}"


def build_armature(scene: bpy.types.Scene) -> bpy.types.Object:
    """As Mixamo's files come in: y up, centimetres, the object turned and scaled."""
    armature = bpy.data.armatures.new("Mixamo")
    rig = bpy.data.objects.new("Mixamo", armature)
    scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    rig.rotation_euler.x, rig.scale = radians(90.0), (1.0 / UNIT,) * 3
    bpy.ops.object.mode_set(mode="EDIT")
    for index, (bone, head, tail) in enumerate(zip(BONES, rest_joints(), bone_tails(), strict=True)):
        name = mixamo_name(bone)
        if name is None:
            continue
        edit = armature.edit_bones.new(name)
        edit.head, edit.tail = (UNIT * Y_UP @ Vector(point) for point in (head, tail))
        if PARENTS[index] >= 0:
            edit.parent = armature.edit_bones[mixamo_name(BONES[PARENTS[index]])]
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


Y_UP = Matrix.Rotation(radians(-90.0), 3, "X")
"""Blender's axes to the armature's."""


def key_handling(rig: bpy.types.Object, crate: bpy.types.Object, frames: int) -> None:
    """Lifting, turning and putting down: rotations of all bones, the hips' place, and the crate's."""
    moments = performance(NOVEL)
    crate.rotation_mode = "QUATERNION"
    for frame in range(1, frames + 1):
        moment = moments((frame - 1) / max(frames - 1, 1))
        for index, bone in enumerate(BONES):
            name, parent = mixamo_name(bone), PARENTS[index]
            if name is None:
                continue
            above = moment.rotations[parent] if parent >= 0 else np.eye(3)
            _turn(rig.pose.bones[name], Y_UP @ Matrix((above.T @ moment.rotations[index]).tolist()) @ Y_UP.transposed())
            rig.pose.bones[name].keyframe_insert("rotation_quaternion", frame=frame)
        hips = rig.pose.bones[mixamo_name("pelvis")]
        shift = UNIT * Y_UP @ Vector(moment.pelvis - rest_joints()[0])
        hips.location = hips.bone.matrix_local.to_3x3().inverted() @ shift
        hips.keyframe_insert("location", frame=frame)
        place = Matrix(moment.crate.tolist())
        crate.location, crate.rotation_quaternion = place.to_translation(), place.to_quaternion()
        crate.keyframe_insert("location", frame=frame)
        crate.keyframe_insert("rotation_quaternion", frame=frame)


def _turn(bone: bpy.types.PoseBone, rotation: Matrix) -> None:
    """A rotation in the armature's axes as the bone's own."""
    axes = bone.bone.matrix_local.to_3x3()
    bone.rotation_mode = "QUATERNION"
    bone.rotation_quaternion = (axes.inverted() @ rotation @ axes).to_quaternion()


def build_stage(scene: bpy.types.Scene, size: tuple[int, int], samples: int, frames: int) -> None:
    """The room, its lights, a camera and the render's settings."""
    for item in list(scene.objects):
        bpy.data.objects.remove(item)
    add_lights(scene)
    build_room(scene)
    set_render(scene, *size, samples)
    scene.render.fps = 8
    scene.frame_start, scene.frame_end = 1, frames
    scene.camera = add_camera(scene, "Camera", (1.05, -3.0, 1.35), (-0.02, 0.0, 0.9), 36.0)

"""Performances as keyframes on armatures and empties."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import bpy
import numpy as np
from mathutils import Matrix

from demo.body import BONES, PARENTS, rest_joints
from demo.poses import Moment


def key_performance(
    armature: bpy.types.Object,
    carrier: bpy.types.Object,
    moment_at: Callable[[float], Moment],
    frames: Sequence[int],
    bone_names: Sequence[str] = BONES,
) -> None:
    """Keys every frame: rotations of all bones, the root's place, and the object's.

    Args:
        armature: any armature in T-pose whose bones ``bone_names`` are the demo's, in their order; its rest joints may
            stand at another place than the demo's, their relative places must agree.
        carrier: the empty or object that carries the crate.
        moment_at: pose at a time in 0…1, which the frames spread over evenly.
    """
    rest = rest_joints()
    shift = np.array(armature.data.bones[bone_names[0]].head_local) - rest[0]
    last = max(len(frames) - 1, 1)
    carrier.rotation_mode = "QUATERNION"
    for number, frame in enumerate(frames):
        moment = moment_at(number / last)
        for index, name in enumerate(bone_names):
            bone = armature.pose.bones[name]
            bone.rotation_mode = "QUATERNION"
            parent = PARENTS[index]
            before = moment.rotations[parent] if parent >= 0 else np.eye(3)
            local = Matrix((before.T @ moment.rotations[index]).tolist())
            axes = bone.bone.matrix_local.to_3x3()
            bone.rotation_quaternion = (axes.inverted() @ local @ axes).to_quaternion()
            bone.keyframe_insert("rotation_quaternion", frame=frame)
            if parent < 0:
                bone.location = axes.inverted() @ Matrix.Identity(3) @ _vector(moment.pelvis - rest[0])
                bone.keyframe_insert("location", frame=frame)
        # The shift of the armature's own rest moves the whole figure; the crate moves along.
        place = Matrix(moment.crate.tolist())
        world = armature.matrix_world @ Matrix.Translation(shift.tolist()) @ place
        carrier.location = world.to_translation()
        carrier.rotation_quaternion = world.to_quaternion()
        carrier.keyframe_insert("location", frame=frame)
        carrier.keyframe_insert("rotation_quaternion", frame=frame)


def _vector(values: np.ndarray) -> bpy.types.bpy_struct:
    return Matrix.Translation(values.tolist()).to_translation()

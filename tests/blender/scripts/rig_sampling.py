"""Samples one figure from armatures that differ in unit, axes, parents and what moves them. Argument: a model file."""

from __future__ import annotations

import sys
from collections.abc import Callable
from math import radians
from pathlib import Path

import bpy
import numpy as np
from bpy.types import Object
from mathutils import Euler, Matrix, Vector
from operation_scene import say

from chona_blender.errors import ChonaError
from chona_blender.model_header import read_model_header
from chona_blender.rig.armature import Rig, create_rig
from chona_blender.rig.rest_pose import model_rest_pose
from chona_blender.rig.rigid import RigidPose, rigid_pose
from chona_blender.rig.sampling import Subject, sample, sample_all

FRAMES = (1, 3, 5)
PLACE = Matrix.Translation((0.4, -1.1, 0.2)) @ Matrix.Rotation(0.7, 4, "Z")
header = read_model_header(Path(sys.argv[1]))
NAMES = list(header.names)
JOINTS = header.rest_joints("Robin")


def fresh() -> Rig:
    """An empty scene with the model's rig, unposed."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return create_rig(bpy.context.scene, header, "Robin", ["crate"])


def edit_rest(armature: Object, change: Matrix, roll: float = 0.0) -> None:
    """Moves the rest bones by ``change`` and rolls them."""
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in armature.data.edit_bones:
        bone.transform(change, scale=True, roll=True)
        bone.roll += roll
    bpy.ops.object.mode_set(mode="OBJECT")


def animate(armature: Object, unit: float = 1.0, axes: Matrix | None = None) -> None:
    """Keys one and the same motion, given in canonical axes, whatever the bones' own axes are."""
    armature_from_canonical = axes or Matrix.Rotation(radians(90.0), 3, "X")
    for frame in (1, 5):
        random = np.random.default_rng(frame)
        for name in NAMES:
            bone = armature.pose.bones[name]
            turn = armature_from_canonical @ Euler(random.normal(0, 0.4, 3)).to_matrix()
            turn = turn @ armature_from_canonical.inverted()
            rest = bone.bone.matrix_local.to_3x3()
            bone.rotation_mode = "QUATERNION"
            bone.rotation_quaternion = (rest.inverted() @ turn @ rest).to_quaternion()
            bone.keyframe_insert("rotation_quaternion", frame=frame)
            if name == "pelvis":
                moved = armature_from_canonical @ Vector(random.normal(0, 0.3, 3)) * unit
                bone.location = rest.inverted() @ moved
                bone.keyframe_insert("location", frame=frame)


def take(rig: Rig) -> RigidPose:
    """What the add-on samples of a rig."""
    rest = model_rest_pose(rig.armature, NAMES, JOINTS)
    samples = sample(bpy.context.scene, rig.armature, NAMES, [rig.empties["crate"]], frames=FRAMES)
    return rigid_pose(samples, rest, NAMES, ["crate"])


def answer(rig: Rig) -> dict:
    """The sampled pose, or the message of the refusal."""
    try:
        pose = take(rig)
    except ChonaError as error:
        return {"error": str(error)}
    return {
        "bones": pose.world_from_bone.tolist(), "objects": pose.world_from_object.tolist(), "scale": pose.scale,
        "dropped": [[each.name, each.frame, each.scale, each.shear] for each in pose.dropped],
    }  # fmt: skip


def plain(rig: Rig) -> None:
    """Metres, z up."""
    rig.armature.matrix_world = PLACE
    animate(rig.armature)


def centimetres(rig: Rig) -> None:
    """Bones in centimetres under an object of scale 0.01."""
    edit_rest(rig.armature, Matrix.Scale(100.0, 4))
    rig.armature.matrix_world = PLACE @ Matrix.Scale(0.01, 4)
    animate(rig.armature, unit=100.0)


def y_up(rig: Rig) -> None:
    """Bones y up under an object turned by 90 degrees."""
    turn = Matrix.Rotation(radians(90.0), 4, "X")
    edit_rest(rig.armature, turn.inverted())
    rig.armature.matrix_world = PLACE @ turn
    animate(rig.armature, axes=Matrix.Identity(3))


def rolled(rig: Rig) -> None:
    """Every bone rolled about its own axis."""
    edit_rest(rig.armature, Matrix.Identity(4), roll=1.1)
    plain(rig)


def parented(rig: Rig) -> None:
    """Under a moved, turned and scaled parent that takes the scale back."""
    parent = bpy.data.objects.new("parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.matrix_world = Matrix.Translation((3, 2, 1)) @ Matrix.Rotation(1.0, 4, "Y") @ Matrix.Scale(2.0, 4)
    bpy.context.view_layer.update()
    rig.armature.parent = parent
    rig.armature.matrix_world = PLACE
    animate(rig.armature)


def larger(rig: Rig) -> None:
    """A figure 1.5 times its size."""
    plain(rig)
    rig.armature.matrix_world = PLACE @ Matrix.Scale(1.5, 4)
    rig.empties["crate"].scale = (1.5, 1.5, 1.5)


def stretch(amount: float) -> Callable[[Rig], None]:
    """The left knee stretched along itself in frame 3."""

    def change(rig: Rig) -> None:
        plain(rig)
        bone = rig.armature.pose.bones["left_ankle"]
        for frame, scale in ((1, 1.0), (3, amount), (5, 1.0)):
            bone.scale = (1.0, scale, 1.0)
            bone.keyframe_insert("scale", frame=frame)

    return change


def mirrored(rig: Rig) -> None:
    """A negative scale."""
    plain(rig)
    rig.armature.scale.x *= -1


def flat(rig: Rig) -> None:
    """A bone without width."""
    plain(rig)
    rig.armature.pose.bones["head"].scale = (0.0, 1.0, 1.0)


def falling() -> dict:
    """A cube falls by the rigid body simulation, and the object's empty hangs on it."""
    rig = fresh()
    plain(rig)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(3.0, 0.0, 5.0))
    cube = bpy.context.object
    bpy.ops.rigidbody.world_add()
    bpy.ops.rigidbody.object_add(type="ACTIVE")
    rig.empties["crate"].parent = cube
    rig.empties["crate"].matrix_basis = Matrix.Identity(4)
    scene.frame_set(4)
    rig.armature.pose.bones["head"].rotation_mode = "XYZ"
    rig.armature.pose.bones["head"].rotation_euler.x = 0.123
    samples = sample(scene, None, [], [rig.empties["crate"]], frames=(1, 6, 12))
    result = {"objects": samples.world_from_object.tolist(), "frames": [1, 6, 12], "frame": scene.frame_current}
    subject = Subject(None, [], [rig.empties["crate"]])
    (shutter,) = sample_all(scene, [subject], frames=(5, 6, 9), moments=(0.0, -0.5, 0.25, 0.75))
    result["shutter"] = shutter.world_from_object[:, 0, 2, 3].reshape(3, 4).tolist()
    result["unkeyed"] = rig.armature.pose.bones["head"].rotation_euler.x
    result["played"] = []
    for frame in range(1, 13):
        scene.frame_set(frame)
        if frame in result["frames"]:
            at = bpy.context.evaluated_depsgraph_get()
            result["played"].append(rig.empties["crate"].evaluated_get(at).matrix_world.translation.z)
    return result


def edited(rig: Rig) -> None:
    """Left in edit mode."""
    plain(rig)
    bpy.context.view_layer.objects.active = rig.armature
    bpy.ops.object.mode_set(mode="EDIT")


def resting(rig: Rig) -> None:
    """Shown in its rest position."""
    plain(rig)
    rig.armature.data.pose_position = "REST"


def controlled() -> dict:
    """IK to a keyed target, a driver, a bone-parented empty; beside what Blender evaluates in the user's own scene."""
    rig = fresh()
    scene, armature, empty = bpy.context.scene, rig.armature, rig.empties["crate"]
    armature.matrix_world = PLACE
    target = bpy.data.objects.new("target", None)
    scene.collection.objects.link(target)
    for frame, place in ((1, (0.5, -0.25, 1.3)), (5, (0.35, -0.3, 1.15))):
        target.location = PLACE @ Vector(place)
        target.keyframe_insert("location", frame=frame)
    inverse = armature.pose.bones["left_elbow"].constraints.new("IK")
    inverse.target, inverse.chain_count = target, 2
    armature["nod"] = 0.0
    for frame, value in ((1, 0.0), (5, 0.8)):
        armature["nod"] = value
        armature.keyframe_insert('["nod"]', frame=frame)
    head = armature.pose.bones["head"]
    head.rotation_mode = "XYZ"
    driver = head.driver_add("rotation_euler", 0).driver
    variable = driver.variables.new()
    variable.name, variable.targets[0].id, variable.targets[0].data_path = "nod", armature, '["nod"]'
    driver.expression = "nod"
    empty.parent, empty.parent_type, empty.parent_bone = armature, "BONE", "right_wrist"
    empty.matrix_basis = Matrix.Translation((0.0, 0.1, 0.05)) @ Matrix.Rotation(0.4, 4, "Z")
    # Un-keyed edits and where the user stands.
    scene.frame_set(4)
    knee = armature.pose.bones["right_knee"]
    knee.rotation_mode = "XYZ"
    knee.rotation_euler = (0.3, 0.0, 0.0)
    armature["nod"] = 0.123
    armature.select_set(False)
    target.select_set(True)
    bpy.context.view_layer.objects.active = target
    before = state(scene, armature, target)
    result = answer(rig)
    result["unchanged"] = before == state(scene, armature, target)
    result["reached"], result["evaluated"], result["held"] = [], [], []
    for frame in FRAMES:
        scene.frame_set(frame)
        at = bpy.context.evaluated_depsgraph_get()
        posed = armature.evaluated_get(at)
        tail = posed.matrix_world @ posed.pose.bones["left_elbow"].tail
        result["reached"].append((tail - target.evaluated_get(at).matrix_world.translation).length)
        result["evaluated"].append(
            [[list(row) for row in posed.matrix_world @ posed.pose.bones[name].matrix
              @ posed.pose.bones[name].bone.matrix_local.inverted()] for name in NAMES]
        )  # fmt: skip
        result["held"].append([list(row) for row in empty.evaluated_get(at).matrix_world])
    return result


def state(scene: bpy.types.Scene, armature: Object, target: Object) -> list:
    """What sampling must leave alone."""
    return [
        scene.frame_current, bpy.context.view_layer.objects.active.name, armature.select_get(), target.select_get(),
        tuple(armature.pose.bones["right_knee"].rotation_euler), armature["nod"], tuple(target.location),
        sorted(each.name for each in bpy.data.scenes), sorted(each.name for each in bpy.data.objects),
    ]  # fmt: skip


cases = {
    "plain": plain, "centimetres": centimetres, "y_up": y_up, "rolled": rolled, "parented": parented, "larger": larger,
    "little_stretch": stretch(1.06), "stretched": stretch(1.4), "mirrored": mirrored, "flat": flat,
    "edited": edited, "resting": resting,
}  # fmt: skip
found = {}
for name, prepare in cases.items():
    rig = fresh()
    prepare(rig)
    bpy.context.view_layer.update()
    found[name] = answer(rig)
    if rig.armature.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
found["controlled"] = controlled()
found["falling"] = falling()
say(found)

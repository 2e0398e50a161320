"""The animator's whole job without a window. Arguments: model of the tiny capture, worker's Python, output folder.

A Mixamo rig walks and turns with a box before its chest, between a wall behind and a pillar in front of it.
"""

from __future__ import annotations

import os
import sys
from math import radians
from pathlib import Path

import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector
from operation_scene import emission_plane, empty_scene, render, say
from rig_bodies import RIGS, M, build

import chona_blender
from chona_blender import check_store, commands, compositing, standin

model, python, out = (Path(part) for part in sys.argv[1:4])
os.environ["CHONA_WORKER_PYTHON"] = str(python)
LAST, MIDDLE = 10, 5
WIDTH, HEIGHT = 96, 72
BOX_BEFORE_HIPS = Vector((0.0, -0.4, 0.4))
"""Where the tiny capture's box is, metres."""


def build_set() -> bpy.types.Scene:
    """A camera at chest height that looks along y, a wall of two colours behind the stage, a pillar before it."""
    scene = empty_scene()
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.camera.data.type, scene.camera.data.lens = "PERSP", 45.0
    scene.camera.location, scene.camera.rotation_euler = (0.0, -2.6, 1.3), (radians(90.0), 0.0, 0.0)
    emission_plane("pillar", (0.1, 4.0), (-0.1, -1.0, 1.0), (0.8, 0.1, 0.1))
    emission_plane("wall", (3.0, 6.0), (-1.5, 2.0, 1.0), (0.1, 0.7, 0.1))
    emission_plane("wall", (3.0, 6.0), (1.5, 2.0, 1.0), (0.1, 0.1, 0.6))
    for item in scene.objects:
        if item.type == "MESH":
            item.rotation_euler.x = radians(90.0)
    scene.frame_start, scene.frame_end = 1, LAST
    return scene


def walk(rig: bpy.types.Object) -> None:
    """From left to right, the trunk turning and bending."""
    for frame, across, turn, bend in ((1, -0.3, 0.4, 0.0), (MIDDLE, 0.0, 0.1, 0.2), (LAST, 0.3, -0.4, 0.1)):
        for name, angles in (("Hips", (0.0, turn, 0.0)), ("Spine2", (bend, 0.0, 0.0)), ("Head", (-bend, -turn, 0.0))):
            bone = rig.pose.bones[M + name]
            armature_from_bone = bone.bone.matrix_local.to_quaternion()
            bone.rotation_mode = "QUATERNION"
            bone.rotation_quaternion = (
                armature_from_bone.inverted() @ Euler(angles).to_quaternion() @ armature_from_bone
            )
            bone.keyframe_insert("rotation_quaternion", frame=frame)
        hips = rig.pose.bones[f"{M}Hips"]
        shift = Vector((across, 0.0, 0.0)) / rig.scale.x  # Mixamo's centimetres
        hips.location = hips.bone.matrix_local.to_quaternion().inverted() @ shift
        hips.keyframe_insert("location", frame=frame)


def hand_over(box: bpy.types.Object, rig: bpy.types.Object) -> None:
    """The box hangs on the hips."""
    bone = rig.pose.bones[f"{M}Hips"]
    box.parent, box.parent_type, box.parent_bone = rig, "BONE", bone.name
    bpy.context.view_layer.update()
    box.matrix_world = Matrix.Translation(rig.matrix_world @ bone.head + BOX_BEFORE_HIPS)
    bpy.context.view_layer.update()


def add_floor_and_sun(scene: bpy.types.Scene) -> None:
    """A white floor, and a lamp without size high in front, on the left: a sharp shadow goes back to the right."""
    bpy.ops.mesh.primitive_plane_add(size=6.0, location=(0.0, 0.0, 0.5))
    bpy.ops.object.light_add(type="SUN", rotation=(radians(50.0), 0.0, radians(-20.0)))
    bpy.context.object.data.energy, bpy.context.object.data.angle = 3.0, 0.0
    scene.cycles.max_bounces = 0


def in_picture(scene: bpy.types.Scene, point: Vector) -> list[float]:
    """Column and row of a point of the world, as Blender's camera sees it, and its depth in metres."""
    across, up, depth = world_to_camera_view(scene, scene.camera, point)
    return [across * WIDTH, (1.0 - up) * HEIGHT, depth]


def frame_path(kind: str, number: int) -> Path:
    return out / f"{kind}_{number:04d}.exr"


answer: dict = {"version": list(bpy.app.version), "joints": {}}
chona_blender.register()
scene = build_set()
rig = build(RIGS["mixamo"])
walk(rig)

settings = scene.chona
settings.first_model = str(model)
settings.armature = rig
bpy.ops.chona.map_rig()
answer["mapped"] = settings.actor.family
settings.actor.bones["chest"].target = f"{M}Spine2"  # a trunk of one bone: no family's table has it
answer["chosen"] = settings.actor.family
bpy.context.view_layer.objects.active = rig
bpy.ops.chona.object_add(object="box01")
box = settings.objects[0].empty
hand_over(box, rig)
answer["checked"] = list(bpy.ops.chona.check())
answer["findings"] = [[each.kind, each.words] for each in check_store.report_of(scene).findings]

render(scene, frame_path("plate", 1), 1)
settings.name, settings.output_folder, settings.preset = "walk", str(out / "frames"), "final"
settings.passes.normal = True
answer["baked"] = list(bpy.ops.chona.bake())
render(scene, frame_path("composite", 1), 1)
for number in range(1, LAST + 1):
    render(scene, frame_path("composite", number), number)
    answer["joints"][number] = {
        "hips": in_picture(scene, rig.matrix_world @ rig.pose.bones[f"{M}Hips"].head),
        "chest": in_picture(scene, rig.matrix_world @ rig.pose.bones[f"{M}Spine2"].head),
        "box": in_picture(scene, box.matrix_world.translation),
    }
render(scene, frame_path("composite", LAST + 1), LAST + 1)
answer["baked again"] = commands.main(["bake"])
answer["removed"] = [commands.main(["composite", "--remove"]), compositing.has_layers(scene)]
render(scene, frame_path("removed", MIDDLE), MIDDLE)

bpy.ops.chona.stand_in_make()
meshes = standin.stand_ins(settings.actor)
answer["stand-in"] = {item["chona_stand_in"]: [len(item.data.polygons), item.hide_render] for item in meshes}
add_floor_and_sun(scene)
render(scene, frame_path("lit", MIDDLE), MIDDLE)
settings.composite.shadows = True
answer["with shadows"] = list(bpy.ops.chona.composite())
render(scene, frame_path("shadow", MIDDLE), MIDDLE)

scene.frame_set(MIDDLE)
scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
settings.name, settings.frame_range, settings.composite_after = "blurred", "CURRENT", False
answer["blurred"] = list(bpy.ops.chona.bake())
chona_blender.unregister()
say(answer)

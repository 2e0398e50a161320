"""A character of two bones and a cube, and a crate, small enough to be captured in seconds."""

from __future__ import annotations

import bpy
from operation_scene import empty_scene


def build() -> bpy.types.Scene:
    """An empty scene with armature ``Robin``, a body that it deforms and walks with, ``crate`` and a lamp."""
    scene = empty_scene()
    data = bpy.data.armatures.new("Robin")
    armature = bpy.data.objects.new("Robin", data)
    scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for name, head, tail in (("pelvis", (0, 0, 0.5), (0, 0, 1.0)), ("spine", (0, 0, 1.0), (0, 0, 1.5))):
        bone = data.edit_bones.new(name)
        bone.head, bone.tail = head, tail
    bpy.ops.object.mode_set(mode="OBJECT")
    for frame, x in ((1, -0.3), (6, 0.3)):
        armature.location.x = x
        armature.keyframe_insert("location", frame=frame)
    bpy.ops.mesh.primitive_monkey_add(size=0.8, location=(0, 0, 1.0))
    body = bpy.context.object
    body.vertex_groups.new(name="pelvis").add(list(range(len(body.data.vertices))), 1.0, "REPLACE")
    body.modifiers.new("rig", "ARMATURE").object = armature
    bpy.ops.mesh.primitive_cube_add(size=0.3, location=(0, -0.8, 0.5))
    bpy.context.object.name = "crate"
    bpy.ops.object.light_add(type="SUN", rotation=(0.6, 0.3, 0.0))
    return scene


OPTIONS = [
    "--capture-armature", "Robin", "--capture-object", "crate", "--capture-cameras", "3", "--capture-width", "64",
    "--capture-height", "48", "--capture-samples", "8", "--frames", "1-4",
]  # fmt: skip

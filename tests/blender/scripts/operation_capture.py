"""Captures a tiny rigged scene through the command. Argument: folder."""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path

import bpy
from operation_scene import empty_scene, say

import chona_blender
from chona_blender import commands

folder = Path(sys.argv[1])
chona_blender.register()
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
bpy.ops.mesh.primitive_cube_add(size=0.4, location=(0, 0, 1.0))
body = bpy.context.object
body.vertex_groups.new(name="pelvis").add(list(range(8)), 1.0, "REPLACE")
body.modifiers.new("rig", "ARMATURE").object = armature
bpy.ops.mesh.primitive_cube_add(size=0.3, location=(0, -0.8, 0.5))
bpy.context.object.name = "crate"
words, events = io.StringIO(), io.StringIO()
options = [
    "--capture-armature",
    "Robin",
    "--capture-object",
    "crate",
    "--capture-folder",
    str(folder),
    "--frames",
    "1-2",
]
options += ["--capture-cameras", "2", "--capture-width", "32", "--capture-height", "24", "--capture-samples", "1"]
with contextlib.redirect_stderr(words), contextlib.redirect_stdout(events):
    codes = [commands.main(["capture", *options, "--progress", "json"]) for _ in range(2)]
    codes.append(commands.main(["capture", "--capture-folder", str(folder), "--frames", "5-4"]))
say({"codes": codes, "words": words.getvalue(), "events": events.getvalue().count('"event": "progress"')})

"""Makes the blend file that a farm is sent, in real Blender. Arguments after --: model, blend file, frames' folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from bl_ext.user_default.chona import commands

model, target, folder = (Path(part) for part in sys.argv[sys.argv.index("--") + 1 :])
for name in ("Cube", "Light"):
    bpy.data.objects.remove(bpy.data.objects[name])
scene = bpy.context.scene
scene.camera.location, scene.camera.rotation_euler = (0.0, -1.5, 0.0), (1.5707963, 0.0, 0.0)
scene.render.engine, scene.cycles.samples = "CYCLES", 1
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 64, 48, 100
scene.view_settings.view_transform = "Standard"
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
scene.frame_start, scene.frame_end = 1, 3
if commands.main(["create-rig", "--model", str(model), "--person", ""]) != 0:
    sys.exit(1)
scene.chona.output_folder, scene.chona.name = str(folder), "roll"
ball = scene.chona.objects[0].empty
for frame in (1, 3):
    ball.location.x = 0.1 * (frame - 2)
    ball.keyframe_insert("location", frame=frame)
bpy.ops.wm.save_as_mainfile(filepath=str(target))

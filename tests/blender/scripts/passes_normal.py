"""Renders a round ball's Normal pass with Cycles under two cameras; says where the cameras are."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from mathutils import Euler, Vector
from operation_scene import say

from chona_blender.camera import image_format, sample_camera

folder, radius = Path(sys.argv[1]), float(sys.argv[2])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, segments=96, ring_count=48, location=(0.4, -0.3, 0.7))
bpy.ops.object.shade_smooth()
data = bpy.data.cameras.new("camera")
camera = bpy.data.objects.new("camera", data)
scene.collection.objects.link(camera)
scene.camera = camera
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising = 4, False
scene.cycles.pixel_filter_type = "BOX"
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 48, 40, 100
scene.view_layers[0].use_pass_normal = True
scene.render.film_transparent = True
if bpy.app.version >= (5, 0, 0):
    scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
scene.render.image_settings.color_depth = "32"
answer: dict = {}
for name, turn in {"level": (1.5, 0.0, 0.4), "rolled, from above": (0.6, 0.9, -1.7)}.items():
    camera.rotation_euler = turn
    camera.location = Euler(turn).to_matrix() @ Vector((0.03, 0.02, 1.6))
    camera.location += bpy.context.object.location
    scene.render.filepath = str(folder / f"{name}.exr")
    bpy.ops.render.render(write_still=True)
    sample = sample_camera(camera, bpy.context.evaluated_depsgraph_get(), image_format(scene))
    answer[name] = {
        "intrinsics": sample.intrinsics.tolist(), "world_from_camera": sample.world_from_camera.tolist(),
        "centre": list(bpy.context.object.location),
    }  # fmt: skip
say(answer)

"""Renders a cross of shining points with Cycles under many cameras; says where each point is seen and where our camera
puts it."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from operation_scene import say

from chona_blender.camera import image_format, sample_camera
from chona_blender.capture_render import read_png

folder = Path(sys.argv[1])
CROSS = [(0.0, 0.0, 1.0), (0.5, 0.1, 1.0), (-0.4, 0.3, 1.1), (0.1, 0.0, 1.45), (0.05, -0.2, 0.6)]
"""Middle, right, left and farther, up, down and nearer: metres."""

CASES: dict[str, dict] = {
    "plain": {},
    "fit horizontal, portrait": {"sensor_fit": "HORIZONTAL", "size": (90, 120)},
    "fit vertical": {"sensor_fit": "VERTICAL", "sensor_height": 20.0},
    "fit vertical, portrait": {"sensor_fit": "VERTICAL", "size": (90, 120)},
    "fit auto, portrait": {"size": (90, 120)},
    "shift": {"shift": (0.11, -0.07)},
    "shift, portrait": {"shift": (-0.09, 0.06), "size": (90, 120)},
    "shift, fit vertical": {"shift": (0.08, 0.05), "sensor_fit": "VERTICAL"},
    "wide pixels": {"aspect": (2.0, 1.0), "lens": 24.0},
    "tall pixels, shift": {"aspect": (1.0, 1.5), "shift": (0.06, 0.04)},
    "tall pixels, fit vertical": {"aspect": (1.0, 1.4), "sensor_fit": "VERTICAL"},
    "percentage": {"percentage": 57, "size": (160, 121)},
    "percentage, shift": {"percentage": 43, "size": (201, 150), "shift": (0.05, -0.05)},
    "orthographic": {"kind": "ORTHO"},
    "orthographic, shift, portrait": {"kind": "ORTHO", "shift": (0.04, 0.05), "size": (90, 120)},
    "scaled camera": {"scale": (2.0, 0.5, 3.0)},
    "cropped border": {"border": (0.1, 0.9, 0.15, 0.95)},
}

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
material = bpy.data.materials.new("shine")
if bpy.app.version < (5, 0, 0):
    material.use_nodes = True
tree = material.node_tree
tree.nodes.clear()
emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
tree.links.new(emission.outputs[0], output.inputs["Surface"])
point = None
bpy.ops.mesh.primitive_uv_sphere_add(radius=0.018, segments=16, ring_count=8)
point = bpy.context.object
point.data.materials.append(material)
data = bpy.data.cameras.new("camera")
camera = bpy.data.objects.new("camera", data)
scene.collection.objects.link(camera)
scene.camera = camera
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising = 16, False
scene.cycles.pixel_filter_type = "BOX"
scene.view_settings.view_transform, scene.render.dither_intensity = "Raw", 0.0
scene.render.image_settings.file_format = "PNG"

answer: dict = {}
for name, case in CASES.items():
    data.type = case.get("kind", "PERSP")
    data.lens, data.ortho_scale = case.get("lens", 42.0), 2.2
    data.sensor_fit = case.get("sensor_fit", "AUTO")
    data.sensor_width, data.sensor_height = 36.0, case.get("sensor_height", 24.0)
    data.shift_x, data.shift_y = case.get("shift", (0.0, 0.0))
    scene.render.resolution_x, scene.render.resolution_y = case.get("size", (120, 90))
    scene.render.resolution_percentage = case.get("percentage", 100)
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = case.get("aspect", (1.0, 1.0))
    border = case.get("border")
    scene.render.use_border = scene.render.use_crop_to_border = border is not None
    if border:
        (scene.render.border_min_x, scene.render.border_max_x, scene.render.border_min_y,
         scene.render.border_max_y) = border  # fmt: skip
    camera.location, camera.scale = (0.9, -2.4, 1.3), case.get("scale", (1.0, 1.0, 1.0))
    camera.rotation_euler = (Vector((0.0, 0.0, 1.02)) - camera.location).to_track_quat("-Z", "Y").to_euler()
    seen, placed = [], []
    for place in CROSS:
        point.location = place
        path = folder / "cross.png"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        light = read_png(path)[..., 0].astype(float)
        light = np.maximum(light - np.median(light), 0.0)  # Blender without a world is grey
        rows, columns = np.indices(light.shape)
        total = light.sum()
        seen.append([float((light * (columns + 0.5)).sum() / total), float((light * (rows + 0.5)).sum() / total)])
        graph = bpy.context.evaluated_depsgraph_get()
        sample = sample_camera(camera, graph, image_format(scene))
        local = np.linalg.inv(sample.world_from_camera) @ [*place, 1.0]
        flat = local[:3] / local[2] if sample.kind == "PERSP" else np.array([local[0], local[1], 1.0])
        placed.append((sample.intrinsics @ flat)[:2].tolist())
    image = image_format(scene)
    shape = list(light.shape[::-1])
    answer[name] = {"seen": seen, "placed": placed, "size": [image.width, image.height], "rendered": shape}
say(answer)

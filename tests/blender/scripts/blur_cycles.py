"""Renders a shining plane that moves or is out of focus with Cycles, and samples it as shots with blur.

Arguments: a folder, a model file with an object 'crate'. Says for each case its picture, its shot and its lens.
"""

from __future__ import annotations

import sys
from dataclasses import asdict
from math import radians
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from operation_scene import say

from chona_blender.blur import SceneBlur, sample_lens, shutter_times
from chona_blender.model_header import read_model_header
from chona_blender.rig.cast import ActorPlan
from chona_blender.shot import sample_actors
from chona_blender.shot_file import save_shot

FRAME, MOMENTS, SAMPLES = 10, 128, 64
folder, header = Path(sys.argv[1]), read_model_header(sys.argv[2])

CASES: dict[str, dict] = {
    "sharp": {},
    "starts": {"speed": (0.7, 0.0, 0.2), "position": "START"},
    "centred": {"speed": (0.7, 0.0, 0.2), "position": "CENTER"},
    "ends": {"speed": (0.7, 0.0, 0.2), "position": "END"},
    "shutter curve": {"speed": (0.9, 0.0, 0.0), "position": "START", "curve": [(0.0, 0.3), (0.7, 1.0), (1.0, 0.6)]},
    "moving camera": {"camera speed": (0.5, 0.3, 0.0), "position": "CENTER"},
    "zooming": {"zoom": 30.0, "position": "START"},
    "behind the focus": {"dof": {"focus_distance": 2.0, "aperture_fstop": 0.15}},
    "before the focus": {"dof": {"focus_distance": 9.0, "aperture_fstop": 0.05}},
    "five blades": {"dof": {"focus_distance": 2.0, "aperture_fstop": 0.1, "aperture_blades": 5,
                            "aperture_rotation": 0.4, "aperture_ratio": 1.6}},
    "orthographic": {"kind": "ORTHO", "dof": {"focus_distance": 2.0, "aperture_fstop": 2.0}},
    "focus object": {"target": "empty", "dof": {"aperture_fstop": 0.15}},
    "focus bone": {"target": "bone", "dof": {"aperture_fstop": 0.15}},
    "all": {"speed": (0.5, 0.0, 0.0), "position": "CENTER", "dof": {"focus_distance": 2.5, "aperture_fstop": 0.2}},
}  # fmt: skip
"""Speeds in metres a frame.  Cycles' table of the shutter's curve is coarse where the curve is near zero."""


def build() -> tuple[bpy.types.Scene, bpy.types.Object, bpy.types.Object]:
    """An empty scene with a plane that shines and a camera 4 m before it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    mesh = bpy.data.meshes.new("card")
    mesh.from_pydata([(-0.3, -0.2, 0), (0.3, -0.2, 0), (0.3, 0.2, 0), (-0.3, 0.2, 0)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("shine")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    mesh.materials.append(material)
    card = bpy.data.objects.new("card", mesh)
    card.rotation_euler = (radians(80.0), 0.2, 0.3)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location, camera.rotation_euler = (0.0, -4.0, 0.0), (radians(90.0), 0.0, 0.0)
    for item in (card, camera):
        scene.collection.objects.link(item)
    scene.camera = camera
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.film_transparent = 96, 72, True
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGBA"
    render.motion_blur_shutter = 0.6
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 256, False, False
    scene.cycles.pixel_filter_type = "BOX"
    render.dither_intensity = 0.0
    scene.frame_set(FRAME)
    return scene, card, camera


def key(item: bpy.types.Object, speed: tuple[float, float, float]) -> None:
    """Keys a motion through where the object is at FRAME; in between it is faster than at the keys."""
    place = item.location.copy()
    for frame in (FRAME - 10, FRAME + 10):
        item.location = place + (frame - FRAME) * Vector(speed)
        item.keyframe_insert("location", frame=frame)


def focus_on(scene: bpy.types.Scene, camera: bpy.types.Object, kind: str) -> None:
    """A moving focus object: 2 m before the camera at FRAME, elsewhere before and after."""
    lens = camera.data.dof
    if kind == "empty":
        target = bpy.data.objects.new("target", None)
        target.location = (0.4, -2.0, 0.3)
        scene.collection.objects.link(target)
        key(target, (0.0, 0.3, 0.0))
    else:
        target = bpy.data.objects.new("target", bpy.data.armatures.new("target"))
        scene.collection.objects.link(target)
        bpy.context.view_layer.objects.active = target
        bpy.ops.object.mode_set(mode="EDIT")
        bone = target.data.edit_bones.new("nose")
        bone.head, bone.tail = (0.0, -1.0, 0.0), (0.0, -1.0, 0.5)
        bpy.ops.object.mode_set(mode="OBJECT")
        target.location = (0.0, -1.0, 0.0)
        lens.focus_subtarget = "nose"
    lens.focus_object = target


def set_curve(scene: bpy.types.Scene, points: list[tuple[float, float]]) -> None:
    mapping = scene.render.motion_blur_shutter_curve
    curve = mapping.curves[0]
    while len(curve.points) > 2:
        curve.points.remove(curve.points[1])
    curve.points[0].location, curve.points[-1].location = points[0], points[-1]
    for place in points[1:-1]:
        curve.points.new(*place)
    for point in curve.points:
        point.handle_type = "VECTOR"
    mapping.update()


answer: dict[str, dict] = {}
for name, case in CASES.items():
    scene, card, camera = build()
    if "speed" in case:
        key(card, case["speed"])
    if "camera speed" in case:
        key(camera, case["camera speed"])
    camera.data.type, camera.data.ortho_scale = case.get("kind", "PERSP"), 3.0
    if "zoom" in case:
        for frame, lens in ((FRAME, 50.0), (FRAME + 1, 50.0 + case["zoom"])):
            camera.data.lens = lens
            camera.data.keyframe_insert("lens", frame=frame)
    if "curve" in case:
        set_curve(scene, case["curve"])
    camera.data.dof.use_dof = "dof" in case
    for option, value in case.get("dof", {}).items():
        setattr(camera.data.dof, option, value)
    if "target" in case:
        focus_on(scene, camera, case["target"])
    scene.render.use_motion_blur = "position" in case
    scene.render.motion_blur_position = case.get("position", "CENTER")
    scene.frame_set(FRAME)
    scene.render.filepath = str(folder / f"{name}.png")
    bpy.ops.render.render(write_still=True)
    times = shutter_times(scene, MOMENTS) if "position" in case else np.zeros(0)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    lens = sample_lens(camera.evaluated_get(depsgraph), depsgraph)
    scene.frame_set(FRAME + 3)  # what is sampled must not hang on the scene's frame
    shot = sample_actors(
        scene, [ActorPlan(header, None, None, {"crate": card})], [FRAME], blur=SceneBlur(times, True, SAMPLES)
    )
    answer[name] = {
        "picture": scene.render.filepath, "shot": str(save_shot(folder / name, shot)), "lens": asdict(lens),
        "times": times.tolist(), "arrays": sorted(shot.arrays), "frame": scene.frame_current,
    }  # fmt: skip
say(answer)

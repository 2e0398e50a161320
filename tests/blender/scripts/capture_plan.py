"""What lies before a capture: rings, the cameras drawn, what is refused, and the estimate beside the real thing.

Argument: folder.
"""

from __future__ import annotations

import shutil
import statistics
import sys
import time
from pathlib import Path

import bpy
import numpy as np
import tiny_character
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from operation_scene import say
from rig_bodies import RIGS, Rig, build

import chona_blender
from chona_blender import capturing, ring_view
from chona_blender.capture import performance
from chona_blender.capture_ring import Ring, Space, cut_off, ring_cameras, ring_poses, ring_radius
from chona_blender.errors import ChonaError

folder = Path(sys.argv[1])
chona_blender.register()
answer: dict = {}


def error_of(call: object) -> str:
    """The words of an error."""
    try:
        call()
    except ChonaError as error:
        return str(error)
    return ""


def planned(rig: Rig) -> dict:
    """What a capture of a family's armature with a mesh on it would be."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = build(rig)
    bpy.ops.mesh.primitive_cube_add(size=0.3, location=(0, 0, 1))
    bpy.context.object.modifiers.new("rig", "ARMATURE").object = item
    scene = bpy.context.scene
    scene.frame_end, scene.chona.capture_armature = 1, item
    scene.chona.capture_folder = str(folder / "family")
    wanted = capturing.check_capture(scene)
    with performance(scene, capturing.cast_of(scene), wanted) as shown:
        middles = np.mean([camera.matrix_world.translation for camera in shown.cameras], axis=0)
        away = [np.linalg.norm(np.array(camera.matrix_world.translation)[:2] - middles[:2]) for camera in shown.cameras]
    place = ring_view.place_of(scene)
    return {
        "bones": len(shown.description["skeleton"]["names"]), "person": wanted.person, "away": float(max(away)),
        "drawn": ring_radius(wanted.ring, place.space, wanted.width, wanted.height), "warnings": shown.warnings,
        "height": float(np.ptp(shown.rest.canonical_joints[:, 1])),
    }  # fmt: skip


scene = tiny_character.build()
settings = scene.chona
space = Space(np.array([1.0, 2.0, 0.5]), 1.2, 0.9)
plain = Ring(4, radius=3.0, stagger=0.0)
answer["plain"] = ring_poses(plain, space, 64, 48).tolist()
answer["rings"] = ring_poses(Ring(4, 3, 3.0, 0.2, 0.7, stagger=0.3), space, 64, 48)[:, :3, 3].tolist()
answer["fitted"] = [ring_radius(Ring(4, lens=40.0), space, *size) for size in ((64, 48), (48, 64), (64, 64))]

points = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 3)) * (0.6, 0.5, 0.9) + (1.0, 2.0, 0.5)
around = Space.around(points)
answer["agrees"] = []
scene.render.resolution_percentage, scene.render.pixel_aspect_x = 100, 1.0
for size in ((64, 48), (48, 64)):
    scene.render.resolution_x, scene.render.resolution_y = size
    for ring in (Ring(5, 2), Ring(5, 2, radius=2.6, stagger=0.4), Ring(4, radius=1.9, lens=50.0, height=0.4)):
        poses = ring_poses(ring, around, *size)
        with ring_cameras(ring, around, *size) as cameras:
            for camera in cameras:
                scene.collection.objects.link(camera)
            bpy.context.view_layer.update()
            seen = []
            for camera in cameras:
                at = [world_to_camera_view(scene, camera, Vector(point)) for point in points]
                seen.append(all(0 <= p.x <= 1 and 0 <= p.y <= 1 and p.z > 0 for p in at))
        short = cut_off(poses, points, ring.lens, *size)
        answer["agrees"].append([ring.radius, int(short.sum()), [not each for each in seen] == short.tolist()])
answer["left"] = len(bpy.data.cameras) - 1

settings.capture_armature, settings.capture_object = scene.objects["Robin"], scene.objects["crate"]
settings.capture_cameras, settings.capture_width, settings.capture_height = 3, 64, 48
settings.capture_samples, settings.capture_folder = 8, str(folder / "capture")
settings.capture_range, settings.capture_frame_start, settings.capture_frame_end = "CUSTOM", 1, 6
objects = sorted(bpy.data.objects.keys())
answer["shown"] = [list(bpy.ops.chona.show_ring()), ring_view.words(scene), ring_view.problem(scene)]
lines = ring_view.lines_of(settings, ring_view._View.place)
answer["lines"] = [list(lines.whole.shape), list(lines.short.shape), list(lines.circles.shape)]
eyes = lines.whole.reshape(3, -1, 2, 3)[:, 0, 0]
poses = ring_poses(settings.capture_ring(), ring_view._View.place.space, 64, 48)
answer["eyes"] = float(np.abs(eyes - poses[:, :3, 3]).max())
settings.capture_radius = 0.5
answer["too near"] = ring_view.lines_of(settings, ring_view._View.place).words
answer["refused"] = error_of(lambda: capturing.run_capture(scene))
settings.capture_radius, settings.capture_rings, settings.capture_lens = 2.0, 2, 80.0
answer["cuts"] = ring_view.lines_of(settings, ring_view._View.place).words
settings.capture_frame_end = 0
answer["no frames"] = [ring_view.words(scene), ring_view.problem(scene), error_of(lambda: capturing.run_capture(scene))]
settings.capture_frame_end, settings.capture_radius, settings.capture_rings, settings.capture_lens = 6, 0.0, 1, 40.0
answer["hidden"] = [list(bpy.ops.chona.show_ring()), ring_view.is_on(), sorted(bpy.data.objects.keys()) == objects]

ratios = []
for _ in range(3):  # a computer that something else keeps busy for a moment spoils one round
    shutil.rmtree(folder / "capture", ignore_errors=True)
    found = capturing.run_estimate(scene)
    answer["nothing written"] = not any((folder / "capture").rglob("*.*"))
    began = time.perf_counter()
    result = capturing.run_capture(scene)
    ratios.append(found.seconds / (time.perf_counter() - began))
size = sum(path.stat().st_size for path in (folder / "capture").rglob("*") if path.is_file())
ratio = statistics.median(ratios)
answer["estimate"] = [found.images, found.cameras, found.finished, ratio, found.bytes / size]
again = capturing.run_estimate(scene)
answer["all there"] = [again.images, again.finished, again.bytes, result.rendered]
answer["unchanged"] = [len(bpy.data.scenes), sorted(bpy.data.objects.keys()) == objects]
bpy.data.objects.remove(scene.objects["Suzanne"])
answer["no mesh"] = error_of(lambda: capturing.run_capture(scene))
answer["operators"] = []
for name in ("capture", "estimate_capture"):
    try:
        answer["operators"].append(str(getattr(bpy.ops.chona, name)()))
    except RuntimeError as error:
        answer["operators"].append(str(error))
answer["families"] = {name: planned(rig) for name, rig in RIGS.items()}
chona_blender.unregister()
say(answer)

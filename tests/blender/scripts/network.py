"""The add-on's whole job by its operators, under the watch of the caller. Arguments: capture, folder."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import bpy
import sitecustomize
from mathutils import Matrix
from operation_scene import say

import chona_blender
from chona_blender import live, train_queue, train_rows, worker, worker_setup

capture, folder = (Path(part) for part in sys.argv[1:3])
CONNECT = "import socket; socket.create_connection(('127.0.0.1', 9), 1.0)"
PATIENCE = 120.0
answer: dict = {"watch": sitecustomize.__file__}


def controls() -> list[list[object]]:
    """Exit code and record of a line that connects: in a Python as this one, and in a worker of the add-on."""
    found = []
    record = Path(os.environ["CHONA_WATCHED"]).with_name("control.txt")
    os.environ["CHONA_WATCHED"] = str(record)
    found.append([subprocess.run([sys.executable, "-c", CONNECT], check=False).returncode, record.read_text()])
    record.unlink()
    child = worker.Worker([str(worker.find_python()[0]), "-c", CONNECT])
    found.append([child.wait(60.0), record.read_text()])
    return found


def previewed() -> str:
    """The preset of the first picture of a live preview."""
    for area in bpy.context.window_manager.windows[0].screen.areas:
        if area.type == "VIEW_3D":
            area.spaces.active.region_3d.view_perspective = "CAMERA"
    bpy.context.view_layer.update()
    bpy.ops.chona.live_preview()
    end = time.monotonic() + PATIENCE
    while live.preview.canvas._picture is None and time.monotonic() < end:
        live.preview.tick()
        time.sleep(0.01)
    words = live.preview.canvas.line.split(" ")[0]
    bpy.ops.chona.live_preview()
    return words


chona_blender.register()
scene = bpy.context.scene
settings = scene.chona
answer["checked"] = list(bpy.ops.chona.check_worker())
settings.data_folder, settings.data_format = str(capture), "blender"
answer["data"] = list(bpy.ops.chona.check_data())
settings.run_folder, settings.train_steps, settings.preview_every = str(folder / "run"), 2, 0.0
train_queue.add(scene)
bpy.ops.chona.run_trainings()
answer["trained"] = [[row.name, row.state] for row in train_rows.rows()]

scene.camera.matrix_world = Matrix(((1, 0, 0, 0), (0, 0, -1, -3), (0, 1, 0, 0.2), (0, 0, 0, 1)))
scene.render.resolution_x, scene.render.resolution_y = 48, 36
scene.frame_start = scene.frame_end = 1
bpy.ops.chona.create_rig()
bpy.ops.chona.actor_add()
settings.active_actor = 1
bpy.ops.chona.create_rig()
settings.name, settings.output_folder, settings.preset = "walk", str(folder / "frames"), "draft"
answer["estimated"] = list(bpy.ops.chona.estimate())
answer["baked"] = list(bpy.ops.chona.bake())
answer["frames"] = [path.name for path in (folder / "frames").glob("*.exr")]
answer["live"] = previewed()
answer["outlook"] = worker_setup.outlook(worker_setup.Choice()).lines
live.stop()
answer["control"] = controls()
chona_blender.unregister()
say(answer)

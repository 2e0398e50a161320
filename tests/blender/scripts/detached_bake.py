"""Bakes that go on without Blender. Arguments: `start` PYTHON MODEL FOLDER, or `pick-up` FOLDER FRAMES.

`start` saves a file, bakes it, and waits to be killed. `pick-up` opens the file, cancels the bake that it finds after
so many frames more, and says what it saw.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import bpy
from operation_scene import say

import chona_blender
from chona_blender import jobs, messages, pick_up, preferences

FRAMES = 400


def start(python: str, model: str, folder: Path) -> None:
    """As an animator would who presses Bake."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.camera.location.z = 3.0
    ball = bpy.data.objects.new("ball", None)
    for item in (scene.camera, ball):
        scene.collection.objects.link(item)
    for frame, place in ((1, -0.4), (FRAMES, 0.4)):
        ball.location.x = place
        ball.keyframe_insert("location", frame=frame)
    scene.render.resolution_x, scene.render.resolution_y = 320, 240
    scene.frame_start, scene.frame_end = 1, FRAMES
    settings = scene.chona
    settings.model_path, settings.person = model, ""
    settings.set_objects({"ball": ball})
    settings.name, settings.output_folder, settings.composite_after = "walk", "//out/", False
    settings.preset, settings.detach = "draft", True
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    preferences._override["python"] = python
    bpy.ops.chona.bake()


def cancel_after(frames: int, seen: list[str]) -> None:
    """What a click on Cancel does while the bake goes on."""
    while jobs.board.last is None or jobs.board.last.total <= 0:
        time.sleep(0.01)
    job = jobs.board.last
    first = job.done
    while job.done < first + frames and job.status == jobs.RUNNING:
        time.sleep(0.01)
    seen += [job.title, job.text]
    job.cancel()


def follow(folder: Path, frames: int) -> dict:
    """What the next Blender does when the file is opened."""
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    threads, seen = threading.active_count(), []
    threading.Thread(target=cancel_after, args=(frames, seen), daemon=True).start()
    result = list(bpy.ops.chona.pick_up())
    job = jobs.board.last
    again = pick_up.running_at(pick_up.bake_place(bpy.context.scene))
    return {
        "result": result, "seen": seen, "status": job.status, "error": job.error, "done": job.done, "total": job.total,
        "nothing left": again is None and not pick_up.is_waiting(), "threads": threading.active_count() - threads,
        "news": messages.news(),
    }  # fmt: skip


chona_blender.register()
if sys.argv[1] == "start":
    start(sys.argv[2], sys.argv[3], Path(sys.argv[4]))
else:
    say(follow(Path(sys.argv[2]), int(sys.argv[3])))
chona_blender.unregister()

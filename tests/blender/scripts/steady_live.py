"""Model, rig, camera and scene come and go while the live preview is on. Arguments: model, worker's Python, folder."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import steady_stage as stage
from operation_scene import say

import chona_blender
from chona_blender import live, looking, model_cache, readiness

model, folder = Path(sys.argv[1]), Path(sys.argv[3])
stage.worker_python()
preview = live.preview
content = model.read_bytes()
answer: dict = {}


def until(condition: Callable[[], object]) -> bool:
    """Tick as Blender's timer would, after Blender has seen what was edited."""
    bpy.context.view_layer.update()
    end = time.monotonic() + stage.PATIENCE
    while not condition():
        if time.monotonic() > end:
            return False
        preview.tick()
        time.sleep(0.01)
    return True


def shown() -> np.ndarray | None:
    """The picture in the view once the pose is at rest; None while something is under way."""
    asked, picture = preview._asked, preview.canvas._picture
    done = preview._changed is None and asked is not None and asked.number == preview._shown
    return picture.rgba if done and picture is not None and preview.canvas.line.startswith("final") else None


def told(name: str) -> None:
    """Wait for a message, which hides the picture."""
    until(lambda: preview.error and preview.canvas.is_empty)
    answer[name] = [preview.error, preview.canvas.alert, preview.canvas.is_empty]


def mended(name: str) -> np.ndarray:
    """Wait for the picture; no message stays."""
    there = until(lambda: shown() is not None)
    answer[name] += [there, preview.error]
    return shown()


def replace(path: Path, new: bytes) -> None:
    """Put another file into a file's place at once."""
    temporary = path.with_suffix(".new")
    temporary.write_bytes(new)
    temporary.replace(path)


def rig_and_object() -> None:
    """The armature is deleted as with X, and as by a script; the object's empty too."""
    scene = bpy.context.scene
    armature, item = scene.chona.armature, scene.chona.objects[0]
    for each in armature.users_collection:
        each.objects.unlink(armature)
    told("armature deleted")
    scene.collection.objects.link(armature)
    mended("armature deleted")
    copy = armature.copy()
    bpy.data.objects.remove(armature)
    told("armature removed")
    scene.collection.objects.link(copy)
    scene.chona.armature = copy
    mended("armature removed")
    place = item.empty.copy()
    bpy.data.objects.remove(item.empty)
    told("empty removed")
    scene.collection.objects.link(place)
    item.empty = place
    mended("empty removed")


def camera_and_scene() -> None:
    """No camera, then another one; the window shows another scene, and the first again."""
    scene, window = bpy.context.scene, bpy.context.window_manager.windows[0]
    camera = scene.camera.copy()
    bpy.data.objects.remove(scene.camera)
    told("camera removed")
    scene.collection.objects.link(camera)
    scene.camera = camera
    stage.look_through_camera()
    mended("camera removed")
    other = bpy.data.scenes.new("Other")
    window.scene = other
    number = preview._asked.number
    for _ in range(20):
        preview.tick()
    answer["other scene"] = [preview.is_on_for(scene), preview.error, preview._asked.number - number]
    window.scene = scene
    stage.look_through_camera()  # Blender leaves the camera's view of a scene without one
    scene.chona.armature.location.z += 0.1
    answer["scene again"] = []
    mended("scene again")
    bpy.data.scenes.remove(other)


def model_file(before: np.ndarray) -> None:
    """Another model of the same people, one of others, half a one, none, and the first again."""
    settings = bpy.context.scene.chona
    replace(model, model.with_name("other.safetensors").read_bytes())
    until(lambda: preview.canvas.is_empty)
    answer["other model"] = []
    answer["other model"].append(float(np.abs(mended("other model") - before).max()))
    replace(model, model.with_name("stranger.safetensors").read_bytes())
    told("stranger")
    model_cache.watch(str(model))
    answer["button"] = readiness.why_not_ready(bpy.context.scene)
    settings.person, settings.objects[0].name = "Sub02", "box02"
    mended("stranger")
    model.write_bytes(content[: len(content) // 2])
    told("half")
    model.write_bytes(content)
    settings.person, settings.objects[0].name = "Sub01", "box01"
    mended("half")
    kept = model.with_suffix(".kept")
    model.rename(kept)
    told("removed")
    answer["poll"] = [bpy.ops.chona.bake.poll(), readiness.why_not_ready(bpy.context.scene)]
    kept.rename(model)
    answer["removed"].append(float(np.abs(mended("removed") - before).max()))
    answer["poll"] += [bpy.ops.chona.bake.poll(), readiness.why_not_ready(bpy.context.scene)]


def panel_looks() -> None:
    """The header that a panel shows follows its file: a thread reads it, a timer hands it over."""
    found = answer["header"] = []
    for name in ("stranger", "one"):
        new = content if name == "one" else model.with_name("stranger.safetensors").read_bytes()
        replace(model, new)
        found.append(list(model_cache.cached(str(model)).persons))
        model_cache._looked.clear()  # it was looked at a moment ago
        model_cache._look_later(str(model))
        model_cache._look_later(str(model))
        threads = len(looking._under_way)
        asked = bpy.app.timers.is_registered(looking._deliver)
        while looking._deliver() is not None:
            time.sleep(0.01)
        found.append([threads, asked, *model_cache.cached(str(model)).persons])
    model_cache._looked.clear()
    model_cache._look_later(str(model))
    bpy.ops.wm.read_factory_settings()
    answer["timer stays"] = bpy.app.timers.is_registered(looking._deliver)


chona_blender.register()
scene = stage.furnish(model, folder / "frames")
bpy.ops.chona.live_preview()
answer["begins"] = []
mended("begins")
rig_and_object()
camera_and_scene()
model_file(shown())
answer["workers"] = len(stage.children())
panel_looks()
answer["after a file"] = [preview.is_on, stage.children()]
chona_blender.unregister()
answer["left"] = [stage.timers(), stage.handlers(), stage.drawing(), stage.threads()]
say(answer)

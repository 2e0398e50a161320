"""The live preview with a real `chona serve`, ticked by hand. Arguments: model, worker's Python."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix
from operation_scene import say

import chona_blender
from chona_blender import live, live_kept, live_pace, live_view, live_worker
from chona_blender.camera import ImageFormat
from chona_blender.shot_file import shot_bytes

model, python = (Path(part) for part in sys.argv[1:3])
os.environ["CHONA_WORKER_PYTHON"] = str(python)
PATIENCE = 90.0
preview = live.preview
answer: dict = {}


def until(condition: Callable[[], object], seconds: float = PATIENCE) -> bool:
    """Tick as Blender's timer would, until something holds."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        preview.tick()
        time.sleep(0.005)
    return True


def picture() -> np.ndarray | None:
    """What the view would draw."""
    shown = preview.canvas._picture
    return None if shown is None else shown.rgba


def preset() -> str:
    """What the line in the view begins with."""
    return preview.canvas.line.split(" ")[0]


def traces() -> list[str]:
    """What a preview that is on has in Blender and in the system."""
    names = ("depsgraph_update_post", "frame_change_post", "undo_post", "redo_post", "load_pre")
    found = [f"{name} {each.__name__}" for name in names for each in getattr(bpy.app.handlers, name)]
    found = [each for each in found if not each.endswith("_on_blendfile_load_pre")]  # Blender 5.2's own
    return found + ["timer"] * bpy.app.timers.is_registered(live._tick) + ["drawing"] * preview.canvas.is_on


def processes() -> int:
    """Workers of this process that live."""
    listed = subprocess.run(["ps", "-o", "stat=,args=", "--ppid", str(os.getpid())], capture_output=True, check=False)
    return sum("serve" in line and not line.startswith("Z") for line in listed.stdout.decode().splitlines())


def settle() -> None:
    """Let Blender see an edit, as its main loop would."""
    bpy.context.view_layer.update()


def look_through_camera() -> None:
    """A scene with the rig before the camera, and a view through it."""
    scene = bpy.context.scene
    for each in list(bpy.data.objects):
        if each.type != "CAMERA":
            bpy.data.objects.remove(each)
    scene.camera.matrix_world = Matrix(((1, 0, 0, 0), (0, 0, -1, -3), (0, 1, 0, 0.2), (0, 0, 0, 1)))
    scene.render.resolution_x, scene.render.resolution_y = 96, 72  # quick even in final quality
    scene.chona.model_path = str(model)
    bpy.ops.chona.create_rig()
    for area in bpy.context.window_manager.windows[0].screen.areas:
        if area.type == "VIEW_3D":
            area.spaces.active.region_3d.view_perspective = "CAMERA"
    settle()


def follow_pose() -> None:
    """From nothing to a final picture, then an edit that has no key, on a channel that has one."""
    scene = bpy.context.scene
    chest = scene.chona.armature.pose.bones[1]
    chest.rotation_mode = "XYZ"
    chest.keyframe_insert("rotation_euler", frame=1)
    answer["poll"] = bpy.ops.chona.live_preview.poll()
    answer["toggled"] = list(bpy.ops.chona.live_preview())
    preview.tick()
    answer["while loading"] = preview.canvas.line
    seen: list[str] = []
    until(lambda: seen.append(preset()) or preset() == "final")
    answer["stages"] = [name for name in dict.fromkeys(seen) if name in {"draft", "preview", "final"}]
    answer["sizes"] = list(picture().shape)
    first = picture()
    answer["covered"] = float((first[..., 3] > 0.5).mean())

    number = preview._asked.number
    scene.frame_end += 1  # says nothing about the picture
    settle()
    until(lambda: preview._changed is None)
    answer["asked for nothing"] = preview._asked.number - number

    chest.rotation_euler.x = 0.8
    settle()
    answer["noticed"] = preview._changed is not None
    began = time.monotonic()
    until(lambda: preset() == "draft")
    answer["seconds to a draft"] = time.monotonic() - began
    until(lambda: preset() == "final")
    second = picture()
    if "CHONA_PICTURES" in os.environ:
        np.savez(Path(os.environ["CHONA_PICTURES"]) / "live.npz", first=first, second=second)
    answer["change"] = float(np.abs(first[..., 3] - second[..., 3]).max())
    answer["edit kept"] = round(chest.rotation_euler.x, 6)


def newest_wins() -> None:
    """Ten requests at once: the last is answered, those before need not be."""
    worker = preview._worker
    content = shot_bytes(preview._shot)
    numbers = [worker.ask(content, "draft", 0.5) for _ in range(10)]
    until(lambda: not worker.busy)
    answer["newest"] = worker.newest().number - numbers[-1]
    worker.ask(b"nonsense", "draft", 0.5)
    until(lambda: worker.error)
    answer["refused"] = worker.error
    answer["alive after a refusal"] = worker.alive


def settled(actors: int) -> bool:
    """Whether so many are in the final picture, and nothing is under way."""
    asked, shot = preview._asked, preview._shot
    done = asked is not None and asked.number == preview._shown and preset() == "final"
    return done and shot is not None and len(shot.header["actors"]) == actors


def another_model() -> None:
    """An actor of another file stands beside the first; switched off, it is gone."""
    settings, other = bpy.context.scene.chona, model.with_name("other.safetensors")
    shutil.copy(model, other)
    alone, first = picture()[..., 3], preview._worker
    bpy.ops.chona.actor_add()
    settings.model_path = str(other)
    bpy.ops.chona.create_rig()
    settings.armature.location.x = 0.6
    settle()
    until(lambda: settled(2))
    both = picture()[..., 3]
    middle = both.shape[1] * 5 // 8
    answer["two models"] = [
        [each.get("model", "") for each in preview._shot.header["actors"]],
        float(alone[:, middle:].max()), float(both[:, middle:].max()), preview._worker is first,
    ]  # fmt: skip
    settings.actors[0].use = False
    until(lambda: settled(1))
    answer["first switched off"] = preview._served.name
    settings.actors[0].use = True
    bpy.data.objects.remove(settings.armature)
    settings.actors.remove(1)
    settings.active_actor = 0
    settle()
    until(lambda: preview._served == model.absolute() and picture() is not None and preset() == "final")


def stands_still() -> None:
    """A worker that does not answer while the figure moves: the old picture goes, and a new one comes."""
    process = preview._worker._process.pid
    os.kill(process, signal.SIGSTOP)
    bpy.context.scene.chona.armature.location.x = 0.05
    settle()
    until(lambda: picture() is None, 20.0)
    answer["stands still"] = [picture() is None, preview.canvas.line]
    os.kill(process, signal.SIGCONT)
    until(lambda: picture() is not None)
    answer["goes on"] = preset()


def worker_dies() -> None:
    """A crash is told, and the next change of the pose starts another worker; after a second one a button does."""
    answer["killed"] = []
    armature = bpy.context.scene.chona.armature
    for again in (False, True):
        old = preview._worker
        os.kill(old._process.pid, signal.SIGKILL)
        until(lambda: "signal" in preview.error)
        answer["killed"].append([preview.error, preview.canvas.line, preview.canvas.alert, picture() is None])
        armature.location.x += 0.1
        settle()
        if again:
            until(lambda: preview._changed is None)
            answer["waits"] = [preview.stopped, processes(), bpy.ops.chona.live_restart.poll()]
            bpy.ops.chona.live_restart()
        until(lambda: preset() == "draft")
        answer["restarted"] = [preview.error, preview._worker is not old, processes()]


def model_changes() -> None:
    """Another model file of the same name, while the pose stays: another worker, and the old one is gone."""
    old = preview._worker
    copy = model.with_name("copy.safetensors")
    shutil.copy(model, copy)
    os.utime(copy, ns=(1, 1))
    copy.replace(model)
    until(lambda: preview._worker is not old)
    until(lambda: picture() is not None)
    answer["model changed"] = [preview._worker is not old, old.alive, processes()]


def errors_in_words() -> None:
    """What cannot be sampled is told and hides the picture; put right, the picture is back."""
    armature, empty = bpy.context.scene.chona.armature, bpy.context.scene.chona.objects[0].empty
    told = answer["told"] = {}
    for name, wrong, right in (
        ("hidden", lambda: setattr(empty, "hide_viewport", True), lambda: setattr(empty, "hide_viewport", False)),
        (
            "rest",
            lambda: setattr(armature.data, "pose_position", "REST"),
            lambda: setattr(armature.data, "pose_position", "POSE"),
        ),
    ):
        wrong()
        settle()
        until(lambda: preview.error)
        told[name] = [preview.error, picture() is None]
        right()
        settle()
        until(lambda: picture() is not None)
        told[name] += [preview.error, picture() is None]
    bpy.data.objects.remove(armature)
    settle()
    until(lambda: preview.error)
    told["deleted"] = [preview.error, picture() is None]
    bpy.data.objects.remove(bpy.context.scene.camera)
    settle()
    answer["without camera"] = preview.tick()


def sizes() -> None:
    """Where a cropped render lies in the camera's frame, and how large pictures are asked for."""
    whole = ImageFormat(200, 100, 1.0, 1.0, 50, 10, 100, 60)  # 30 rows below it
    place = live_view.cropped(live_view.Rectangle(1000.0, 500.0, 400.0, 200.0), whole)
    answer["cropped"] = [place.left, place.bottom, place.width, place.height]
    image, pace = ImageFormat.plain(1024, 768), live_pace.Pace()
    scales = [pace.scale(stage, image, 800.0) for stage in range(3)]
    pace.learn(1, 0.1, 400 * 300)
    scales.append(pace.scale(1, image, 800.0))
    pace.learn(2, 8.0, 800 * 600)
    scales.append(pace.scale(2, image, 800.0))
    pace.learn(2, 8000.0, 800 * 600)
    scales.append(pace.scale(2, image, 800.0))
    answer["scales"] = scales
    answer["patience"] = []
    for seconds in (0.01, 0.4, 30.0):
        pace.learn(0, seconds, 256 * 192)
        answer["patience"] += [pace.patience, pace.scale(0, image, 800.0)]


chona_blender.register()
sizes()
look_through_camera()
answer["before"] = traces()
follow_pose()
answer["on"] = traces()
another_model()
newest_wins()
stands_still()
worker_dies()
model_changes()
errors_in_words()

bpy.ops.wm.read_factory_settings()
answer["after a file"] = [traces(), processes(), preview.is_on]

look_through_camera()
most = 0
live_worker.KEPT_SECONDS = 0.3
for _ in range(20):
    bpy.ops.chona.live_preview()
    preview.tick()
    most = max(most, processes())
answer["toggled 20 times"] = [traces(), most, preview.is_on]
end = time.monotonic() + PATIENCE
while processes() and time.monotonic() < end:
    time.sleep(0.1)
answer["left"] = processes()

live_worker.KEPT_SECONDS = 60.0
bpy.ops.chona.live_preview()
until(lambda: picture() is not None)
first = preview._worker
bpy.ops.chona.live_preview()
bpy.ops.chona.live_preview()
answer["warm"] = [preview._worker is first, first.ready]
chona_blender.unregister()
answer["unregistered"] = [traces(), processes()]

# A model that no worker can load: told once, and not tried again with every tick.
chona_blender.register()
look_through_camera()
with model.open("r+b") as file:
    file.truncate(model.stat().st_size - 100)
bpy.ops.chona.live_preview()
until(lambda: preview.error)
broken = preview._worker
for turn in range(5):
    bpy.context.scene.chona.armature.location.x = 0.1 * turn
    settle()
    preview.tick()
answer["broken model"] = [preview.error, preview._worker is broken, processes()]
chona_blender.unregister()
answer["forgotten"] = live_kept._Kept.worker is None
say(answer)

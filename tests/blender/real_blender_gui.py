"""Runs inside the real Blender with a window: installs the zip, works through the sidebar, leaves numbered pictures.

Not collected by pytest; `test_real_blender.py` starts it. After `--`: zip, model, worker's Python, output folder.
Pictures are taken with `scrot`, because Blender's own screenshot is black under software OpenGL.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import bpy

package, model, python, out = (Path(part) for part in sys.argv[sys.argv.index("--") + 1 :][:4])
answer: dict = {"version": list(bpy.app.version), "steps": []}
CLOSED_HEADERS = {"worker": 296, "train": 268, "capture": 240}  # below Model, in a window of 1280 x 860
REAL_MODEL = 1_000_000
"""Bytes: smaller files are headers without tensors, which only look like models."""
SLOW_WORKER = """
import json, sys, time
def say(**event): print(json.dumps(event), flush=True)
say(event="start", job="bake", total=50)
for done in range(1, 51):
    time.sleep(0.2)
    say(event="progress", job="bake", done=done, total=50, seconds=0.2 * done, eta=0.2 * (50 - done), message="shot")
say(event="result", job="bake", written=50, skipped=0, seconds=10.0)
"""


def view_area() -> bpy.types.Area:
    """The 3D view of the first window."""
    screen = bpy.context.window_manager.windows[0].screen
    return next(area for area in screen.areas if area.type == "VIEW_3D")


def picture(name: str) -> None:
    """A picture of the whole screen."""
    subprocess.run(["scrot", "-o", str(out / f"{name}.png")], check=True)
    answer["steps"].append(name)


def call(operator: str, *arguments: str, **options: object) -> set[str]:
    """An operator as a click in the sidebar would call it."""
    area = view_area()
    region = next(each for each in area.regions if each.type == "UI")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=region):
        return getattr(bpy.ops.chona, operator)(*arguments, **options)


def addon() -> str:
    """The name that the add-on has as an extension."""
    return "bl_ext.user_default.chona"


def module(name: str) -> object:
    """One of the add-on's modules."""
    return sys.modules[f"{addon()}.{name}"]


def arrange() -> Iterator[float]:
    """A sidebar that is wide enough, on our tab."""
    area = view_area()
    area.spaces.active.show_region_ui = True
    yield 0.5
    region = next(each for each in area.regions if each.type == "UI")
    region.active_panel_category = "CHONA"
    area.tag_redraw()
    yield 0.8


def story() -> Iterator[float]:
    """What an animator does; each `yield` lets Blender go on for so many seconds."""
    bpy.ops.extensions.package_install_files(filepath=str(package), repo="user_default", enable_on_install=True)
    bpy.ops.wm.save_userpref()
    answer["enabled"] = addon() in bpy.context.preferences.addons
    for name in ("Cube", "Light"):
        bpy.data.objects.remove(bpy.data.objects[name])
    yield 0.5
    yield from arrange()
    picture("01_nothing_set")

    scene = bpy.context.scene
    scene.chona.model_path = str(model)
    answer["rig"] = list(call("create_rig", "EXEC_DEFAULT"))
    scene.chona.output_folder = str(out / "frames")
    scene.frame_end = 50
    look_at_rig()
    yield from redraw()
    picture("02_rig")

    addon_preferences = bpy.context.preferences.addons[addon()].preferences
    addon_preferences.worker_python = sys.executable  # Blender's own Python has no torch
    answer["bake without torch"] = attempt("bake", "INVOKE_DEFAULT")
    yield from redraw()
    picture("03_worker_without_torch")
    answer["error"] = module("jobs").last_error()
    call("dismiss_error")

    addon_preferences.worker_python = str(python)
    answer["check"] = list(call("check_worker", "INVOKE_DEFAULT"))
    yield from until_idle(60.0)
    answer["worker"] = module("diagnosis").worker_report.summary

    real = module("actions").chona_command
    module("actions").chona_command = lambda found, _arguments: [str(found), "-c", SLOW_WORKER]
    scene.chona.composite_after = False
    answer["bake"] = list(call("bake", "INVOKE_DEFAULT"))
    yield 4.0
    picture("04_bake_runs")
    answer["while running"] = module("jobs").running().text
    subprocess.run(["xdotool", "mousemove", "400", "400", "key", "Escape"], check=True)
    yield from until_idle(20.0)
    answer["after escape"] = module("jobs").board.last.status
    module("actions").chona_command = real
    yield from redraw()
    picture("05_cancelled")

    if model.stat().st_size > REAL_MODEL:
        yield from bake_for_real()
        yield from preview_live()
    show_only_closed_panels()
    yield from redraw()
    yield from open_panel("worker")
    yield from open_panel("train")
    picture("06_train_and_worker")
    yield from open_panel("capture")
    picture("07_capture")
    answer["capture"] = list(start_capture())
    yield from until_idle(120.0)
    answer["captured"] = [module("jobs").board.last.status, module("jobs").board.last.report]
    answer["data folder"] = scene.chona.data_folder


def bake_for_real() -> Iterator[float]:
    """A posed figure before the camera, baked by the real worker, composited and rendered with the scene."""
    scene, armature = bpy.context.scene, bpy.context.scene.chona.armature
    scene.render.engine, scene.cycles.samples = "CYCLES", 8
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 480, 360, 100
    scene.camera.location, scene.camera.rotation_euler = (1.6, -3.6, 1.6), (1.33, 0.0, 0.42)
    bpy.ops.mesh.primitive_plane_add(size=8.0)
    bpy.ops.object.light_add(type="SUN", rotation=(0.5, 0.3, 0.0))
    for frame, turn in ((1, -0.4), (3, 0.4)):
        bone = armature.pose.bones[min(2, len(armature.pose.bones) - 1)]
        bone.rotation_mode = "XYZ"
        bone.rotation_euler = (0.0, turn, 0.0)
        bone.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_start, scene.frame_end = 1, 3
    scene.chona.output_folder, scene.chona.composite_after = str(out / "real_frames"), True
    answer["real bake"] = list(call("bake", "INVOKE_DEFAULT"))
    yield 3.0
    picture("08_real_bake_runs")
    yield from until_idle(180.0)
    answer["real bake ended"] = [module("jobs").board.last.status, module("jobs").board.last.report]
    answer["real frames"] = sorted(path.name for path in (out / "real_frames").iterdir())
    yield from redraw()
    picture("09_real_bake_done")
    scene.frame_set(2)
    scene.render.filepath = str(out / "10_composited.png")
    bpy.ops.render.render(write_still=True)


def preview_live() -> Iterator[float]:
    """The live preview in a view through the camera: a picture at rest, one while a bone turns, an error, and off."""
    scene, preview = bpy.context.scene, module("live").preview
    scene.render.resolution_percentage = 200
    view_area().spaces.active.region_3d.view_perspective = "CAMERA"
    yield from redraw()
    answer["live"] = list(call("live_preview", "EXEC_DEFAULT"))
    yield 0.3
    picture("11_live_loading")
    yield from until_live("final")
    yield 0.3
    picture("12_live_at_rest")
    bone = scene.chona.armature.pose.bones[min(2, len(scene.chona.armature.pose.bones) - 1)]
    lines = answer["live lines"] = []
    for turn in range(10):
        bone.rotation_euler.y += 0.06
        for _ in range(40):  # drafts come while the mouse moves
            yield 0.02
            if preview.canvas.line.startswith("draft") and preview.canvas.line not in lines:
                break
        lines.append(preview.canvas.line)
        if turn == 5:
            picture("13_live_moving")
    yield from until_live("final")
    lines.append(preview.canvas.line)
    yield 0.3
    picture("14_live_posed")
    scene.chona.live_opacity = 0.6
    scene.chona.armature.data.pose_position = "REST"
    for _ in range(100):
        yield 0.1
        if preview.error:
            break
    yield from redraw()
    picture("15_live_error")
    answer["live error"] = preview.error
    scene.chona.armature.data.pose_position = "POSE"
    answer["live off"] = list(call("live_preview", "EXEC_DEFAULT"))
    yield from redraw()
    picture("16_live_off")
    answer["live left"] = [preview.is_on, bpy.app.timers.is_registered(module("live")._tick)]
    scene.render.resolution_percentage = 100
    view_area().spaces.active.region_3d.view_perspective = "PERSP"


def until_live(preset: str, seconds: float = 150.0) -> Iterator[float]:
    """Wait for the preview's picture of a preset."""
    end = time.monotonic() + seconds
    while not module("live").preview.canvas.line.startswith(preset) and time.monotonic() < end:
        yield 0.05


def redraw(times: int = 4) -> Iterator[float]:
    """Panels slide to their places over several redraws, which come only when something happens."""
    for _ in range(times):
        for area in bpy.context.window_manager.windows[0].screen.areas:
            area.tag_redraw()
        yield 0.4


def look_at_rig() -> None:
    """Stand before the figure, a little above."""
    space = view_area().spaces.active
    space.region_3d.view_location = (0.0, -0.4, 0.9)
    space.region_3d.view_rotation = (0.78, 0.58, 0.13, 0.18)
    space.region_3d.view_distance = 5.0


def start_capture() -> set[str]:
    """A cube on the armature as character, no object; two tiny pictures."""
    settings = bpy.context.scene.chona
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.0, 0.0, 1.0))
    bpy.context.object.parent = settings.armature
    settings.capture_armature = settings.armature
    settings.capture_folder = str(out / "capture")
    settings.capture_cameras, settings.capture_samples = 2, 1
    settings.capture_width, settings.capture_height = 32, 24
    settings.capture_range, settings.capture_frame_start, settings.capture_frame_end = "CUSTOM", 1, 1
    return call("capture", "INVOKE_DEFAULT")


def show_only_closed_panels() -> None:
    """Take away the panels that begin open, to have room for the others."""
    kept = {"CHONA_PT_main", "CHONA_PT_capture", "CHONA_PT_train", "CHONA_PT_worker", "CHONA_PT_worker_setup"}
    for cls in reversed(module("panels").CLASSES):  # those that stand inside others first
        if issubclass(cls, bpy.types.Panel) and cls.__name__ not in kept:
            bpy.utils.unregister_class(cls)


def open_panel(name: str) -> Iterator[float]:
    """A click on a panel's header; lower ones first, because what is below moves."""
    subprocess.run(["xdotool", "mousemove", "810", str(CLOSED_HEADERS[name]), "click", "1"], check=True)
    yield from redraw()


def attempt(operator: str, *arguments: str) -> str:
    """What an operator answers, or the words of its error."""
    try:
        return str(sorted(call(operator, *arguments)))
    except RuntimeError as error:
        return str(error)


def until_idle(seconds: float) -> Iterator[float]:
    """Wait for the running job."""
    end = time.monotonic() + seconds
    while module("jobs").running() is not None and time.monotonic() < end:
        yield 0.2


def leave(code: int) -> None:
    """Write what was seen and go, without asking whether to save."""
    (out / "answer.json").write_text(json.dumps(answer, indent=1))
    os._exit(code)


steps = story()


def step() -> float | None:
    """One step of the story; a failure ends Blender with its words in the answer."""
    try:
        return next(steps)
    except StopIteration:
        leave(0)
    except Exception:
        answer["failure"] = traceback.format_exc()
        picture("99_failure")
        leave(9)
    return None


bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(step, first_interval=1.0)

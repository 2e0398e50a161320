"""Runs inside the real Blender with a window: a capture's cameras, its estimate and the capture; numbered pictures.

Not collected by pytest. `blender --python-use-system-env --python capture_gui.py -- ZIP FOLDER`, with the repository on
$PYTHONPATH; ZIP is the built extension, and the character is the demo's.
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

from demo.animate import key_performance
from demo.character import build_character
from demo.crate import build_crate
from demo.poses import TRAINED, performance

package, out = (Path(part) for part in sys.argv[sys.argv.index("--") + 1 :][:2])
answer: dict = {"version": list(bpy.app.version)}
SHOWN = {"CHONA_PT_capture", "CHONA_PT_capture_cameras", "CHONA_PT_capture_start"}


def module(name: str) -> object:
    """One of the add-on's modules."""
    return sys.modules[f"bl_ext.user_default.chona.{name}"]


def view_area() -> bpy.types.Area:
    """The 3D view of the first window."""
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "VIEW_3D")


def call(operator: str, **options: object) -> list[str]:
    """An operator as a click in the sidebar would call it."""
    area = view_area()
    region = next(each for each in area.regions if each.type == "UI")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=region):
        return list(getattr(bpy.ops.chona, operator)("INVOKE_DEFAULT", **options))


def picture(name: str, times: int = 4) -> Iterator[float]:
    """A picture of the whole screen, after panels have slid to their places."""
    for _ in range(times):
        for area in bpy.context.window_manager.windows[0].screen.areas:
            area.tag_redraw()
        yield 0.3
    subprocess.run(["scrot", "-o", str(out / f"{name}.png")], check=True)


def until_idle(seconds: float) -> Iterator[float]:
    """Wait for the running job."""
    end = time.monotonic() + seconds
    while module("jobs").running() is not None and time.monotonic() < end:
        yield 0.2


def story() -> Iterator[float]:
    """What an animator does."""
    bpy.ops.extensions.package_install_files(filepath=str(package), repo="user_default", enable_on_install=True)
    for cls in reversed(module("panels").CLASSES):  # room for the panel that this is about
        if issubclass(cls, bpy.types.Panel) and cls.__name__ not in SHOWN:
            bpy.utils.unregister_class(cls)
    learn = module("panels.learn")
    for cls in reversed(learn.CLASSES):
        bpy.utils.unregister_class(cls)
    learn.CHONA_PT_capture.bl_options = set()  # open, for the pictures
    for cls in learn.CLASSES:
        bpy.utils.register_class(cls)
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    scene = bpy.context.scene
    armature, _body = build_character(scene.collection)
    carrier, _crate = build_crate(scene.collection)
    key_performance(armature, carrier, performance(TRAINED[0]), range(1, 11))
    scene.frame_end = 10
    space = view_area().spaces.active
    space.show_region_ui, space.shading.type, space.shading.color_type = True, "SOLID", "TEXTURE"
    space.region_3d.view_location, space.region_3d.view_distance = (0.9, 0.0, 0.9), 9.5
    space.region_3d.view_rotation = (0.78, 0.58, 0.13, 0.18)
    yield 0.5
    region = next(each for each in view_area().regions if each.type == "UI")
    region.active_panel_category = "CHONA"
    settings = scene.chona
    yield from picture("1_nothing")
    settings.capture_armature, settings.capture_object = armature, carrier
    answer["shown"] = call("show_ring")
    yield from picture("2_one_ring")
    settings.capture_rings, settings.capture_cameras, settings.capture_ring_height = 2, 6, 0.3
    yield from picture("3_two_rings")
    settings.capture_radius, settings.capture_lens = 2.2, 50.0
    yield from picture("4_too_near")
    settings.capture_radius, settings.capture_lens, settings.capture_rings, settings.capture_cameras = 0.0, 40.0, 1, 2
    settings.capture_folder, settings.capture_width, settings.capture_height = str(out / "capture"), 128, 96
    settings.capture_samples, settings.capture_range, settings.capture_frame_end = 4, "CUSTOM", 6
    answer["estimate"] = call("estimate_capture")
    yield from until_idle(120.0)
    answer["estimated"] = [module("jobs").board.last.status, module("capturing").last_estimate(scene)]
    answer["report"] = module("jobs").board.last.report
    answer["objects"] = sorted(bpy.data.objects.keys())
    yield from picture("5_estimated")
    answer["capture"] = call("capture")
    yield 8.0
    yield from picture("6_capturing", times=2)
    answer["text"] = module("jobs").running().text if module("jobs").running() else "ended"
    yield from until_idle(180.0)
    answer["captured"] = [module("jobs").board.last.status, module("jobs").board.last.result]
    answer["data"] = settings.data_folder
    yield from picture("7_captured")


steps = story()


def step() -> float | None:
    """One step of the story; a failure ends Blender with its words in the answer."""
    try:
        return next(steps)
    except StopIteration:
        code = 0
    except Exception:
        answer["failure"] = traceback.format_exc()
        code = 9
    (out / "answer.json").write_text(json.dumps(answer, indent=1))
    os._exit(code)


bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(step, first_interval=1.0)

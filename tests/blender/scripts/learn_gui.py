"""Runs inside the real Blender with a window: data are checked, and trained on with a pause; with numbered pictures.

Not collected by pytest. `blender --python-use-system-env --python learn_gui.py -- CAPTURE PYTHON FOLDER [MINUTES]`, the
repository and this folder on $PYTHONPATH; PYTHON is the worker's.
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

import chona_blender
from chona_blender import jobs, panels, preferences, train_data, train_rows

capture, python, out, *more = sys.argv[sys.argv.index("--") + 1 :]
minutes = float(more[0]) if more else 1.0
answer: dict = {"version": list(bpy.app.version)}
SHOWN = {"CHONA_PT_train", "CHONA_PT_train_data", "CHONA_PT_trainings"}


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
    subprocess.run(["scrot", "-o", str(Path(out) / f"{name}.png")], check=True)


def until(done: object, seconds: float) -> Iterator[float]:
    """Wait for something."""
    end = time.monotonic() + seconds
    while not done() and time.monotonic() < end:
        yield 0.2


def story() -> Iterator[float]:
    """What an animator does."""
    preferences._override["python"] = python
    for cls in reversed(panels.CLASSES):  # room for the panel that this is about; those inside others first
        if issubclass(cls, bpy.types.Panel) and cls.__name__ not in SHOWN:
            bpy.utils.unregister_class(cls)
    area = view_area()
    area.spaces.active.show_region_ui = True
    yield 0.5
    region = next(each for each in area.regions if each.type == "UI")
    region.active_panel_category = "CHONA"
    settings = bpy.context.scene.chona
    yield from picture("1_nothing")
    settings.data_folder = capture
    answer["looking"] = train_data.looking(bpy.context.scene)
    yield from until(lambda: train_data.found(bpy.context.scene) is not None, 60.0)
    answer["found"] = train_data.found(bpy.context.scene).headline
    yield from picture("2_found")
    answer["check"] = call("check_data")
    yield from until(lambda: jobs.running() is None, 90.0)
    answer["checked"] = list(train_data.found(bpy.context.scene).warnings)
    yield from picture("3_checked")
    answer["opened"] = call("open_sheet")
    yield from picture("4_opened")
    if len(bpy.context.window_manager.windows) > 1:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
            bpy.ops.wm.window_close()
    bpy.utils.unregister_class(panels.train.CHONA_PT_train_data)
    settings.minutes, settings.preview_every = minutes, 2.0
    for name in ("walk", "walk_long"):
        settings.run_folder = str(Path(out) / name)
        answer[name] = call("train")
        yield 0.5
    answer["states"] = [row.state for row in train_rows.rows()]
    yield from until(lambda: jobs.running() is not None and jobs.running().share > 0.85, 60.0 * minutes + 120.0)
    yield from picture("5_training", times=2)
    answer["while"] = jobs.running().text
    call("pause_training")
    yield from until(lambda: jobs.running() is None, 60.0)
    answer["paused"] = [row.state for row in train_rows.rows()]
    yield from picture("6_paused")
    yield 2.0
    answer["held"] = jobs.running() is None
    train_rows.select(train_rows.rows()[0].key)
    answer["resume"] = call("resume_training")
    yield from until(lambda: train_rows.rows()[0].state == "DONE", 60.0 * minutes + 60.0)
    yield from until(lambda: jobs.running() is not None, 30.0)
    answer["next"] = [row.state for row in train_rows.rows()]
    yield from picture("7_next")
    call("cancel_training")
    yield from until(lambda: jobs.running() is None, 60.0)
    answer["ended"] = [row.state for row in train_rows.rows()]
    train_rows.trainings().active = 0
    answer["used"] = [call("use_trained"), settings.model_path]
    yield from picture("8_done")


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
    (Path(out) / "answer.json").write_text(json.dumps(answer, indent=1))
    os._exit(code)


panels.train.CHONA_PT_train.bl_options = set()  # open, for the pictures
chona_blender.register()
bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(step, first_interval=1.0)

"""Runs inside the real Blender with a window: data are checked, and trained on with a pause; with numbered pictures.

Not collected by pytest. `blender --python-use-system-env --python learn_gui.py -- CAPTURE PYTHON FOLDER [MINUTES]`, the
repository and this folder on $PYTHONPATH; PYTHON is the worker's.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
from window import Drive, call, show_only, show_sidebar, until

import chona_blender
from chona_blender import jobs, panels, preferences, train_data, train_rows

capture, python, out, *more = sys.argv[sys.argv.index("--") + 1 :]
minutes = float(more[0]) if more else 1.0
drive = Drive(Path(out), {"version": list(bpy.app.version)})
answer = drive.answer
SHOWN = {"CHONA_PT_train", "CHONA_PT_train_data", "CHONA_PT_trainings"}


def story() -> Iterator[float]:
    """What an animator does."""
    preferences._override["python"] = python
    show_only(panels, SHOWN)
    yield from show_sidebar()
    settings = bpy.context.scene.chona
    yield from drive.picture("nothing")
    settings.data_folder = capture
    answer["looking"] = train_data.looking(bpy.context.scene)
    yield from until(lambda: train_data.found(bpy.context.scene) is not None, 60.0)
    answer["found"] = train_data.found(bpy.context.scene).headline
    yield from drive.picture("found")
    answer["check"] = call("chona.check_data", "INVOKE_DEFAULT")
    yield from until(lambda: jobs.running() is None, 90.0)
    answer["checked"] = list(train_data.found(bpy.context.scene).warnings)
    yield from drive.picture("checked")
    answer["opened"] = call("chona.open_sheet", "INVOKE_DEFAULT")
    yield from drive.picture("opened")
    if len(bpy.context.window_manager.windows) > 1:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
            bpy.ops.wm.window_close()
    bpy.utils.unregister_class(panels.train.CHONA_PT_train_data)
    settings.minutes, settings.preview_every = minutes, 2.0
    for name in ("walk", "walk_long"):
        settings.run_folder = str(Path(out) / name)
        answer[name] = call("chona.train", "INVOKE_DEFAULT")
        yield 0.5
    answer["states"] = [row.state for row in train_rows.rows()]
    yield from until(lambda: jobs.running() is not None and jobs.running().share > 0.85, 60.0 * minutes + 120.0)
    yield from drive.picture("training", redraws=2)
    answer["while"] = jobs.running().text
    call("chona.pause_training", "INVOKE_DEFAULT")
    yield from until(lambda: jobs.running() is None, 60.0)
    answer["paused"] = [row.state for row in train_rows.rows()]
    yield from drive.picture("paused")
    yield 2.0
    answer["held"] = jobs.running() is None
    train_rows.select(train_rows.rows()[0].key)
    answer["resume"] = call("chona.resume_training", "INVOKE_DEFAULT")
    yield from until(lambda: train_rows.rows()[0].state == "DONE", 60.0 * minutes + 60.0)
    yield from until(lambda: jobs.running() is not None, 30.0)
    answer["next"] = [row.state for row in train_rows.rows()]
    yield from drive.picture("next")
    call("chona.cancel_training", "INVOKE_DEFAULT")
    yield from until(lambda: jobs.running() is None, 60.0)
    answer["ended"] = [row.state for row in train_rows.rows()]
    train_rows.trainings().active = 0
    answer["used"] = [call("chona.use_trained", "INVOKE_DEFAULT"), settings.model_path]
    yield from drive.picture("done")


panels.train.CHONA_PT_train.bl_options = set()  # open, for the pictures
chona_blender.register()
drive.run(story())

"""A training that goes on without Blender.

Arguments: `start` or `pick-up`, worker's Python, capture, folder, tiny_runs.py.  `start` trains, saves its file
meanwhile, and waits to be killed.  `pick-up` opens that file, leaves it and opens it again, and pauses what it finds.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import bpy
from operation_scene import say

import chona_blender
from chona_blender import job_record, jobs, pick_up, preferences, train_queue, train_rows

mode, python, capture, folder, small = sys.argv[1:6]
file, run = str(Path(folder) / "scene.blend"), Path(folder) / "run"
chona_blender.register()
preferences._override["python"] = python
train_queue.detached_command = lambda found, words, record: [
    str(found), small, *words, "--progress-file", str(record)
]  # fmt: skip


def start() -> None:
    """A training whose row is saved with the file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings = bpy.context.scene.chona
    settings.data_folder, settings.data_format, settings.run_folder = capture, "blender", str(run)
    settings.train_steps, settings.preview_every, settings.detach = 10**6, 0.0, True
    job = train_queue.start(train_queue.add(bpy.context.scene))
    bpy.ops.wm.save_as_mainfile(filepath=file)
    while not job.poll():
        time.sleep(0.05)


def states() -> list[list[str]]:
    """The list as the panel shows it."""
    return [[row.name, row.state] for row in train_rows.rows()]


def pause(seen: dict) -> None:
    """What a click on Pause does while the training goes on."""
    job = jobs.board.last
    while job.total <= 0 or job.done < 1:
        time.sleep(0.01)
    seen |= {"title": job.title, "text": job.text}
    job.pause()


def follow() -> dict:
    """What the next Blender does."""
    bpy.ops.wm.open_mainfile(filepath=file)
    seen: dict = {"opened": states()}
    pick_up.look_now()
    job = pick_up.take_next()[1]
    seen["meanwhile"] = states()
    job.close()  # as Blender does when another file is opened
    seen["closed"] = [job.status, bool(job_record.is_running(job_record.train_record(run)))]
    bpy.ops.wm.open_mainfile(filepath=file)

    def wait_and_pause() -> None:
        while jobs.board.last is None:
            time.sleep(0.01)
        pause(seen)

    threading.Thread(target=wait_and_pause, daemon=True).start()
    seen["result"] = list(bpy.ops.chona.pick_up())
    seen["paused"] = [[row.name, row.state, row.resume] for row in train_rows.rows()]
    return seen


if mode == "start":
    start()
else:
    say(follow())
chona_blender.unregister()

"""Trainings in the list: order, pause and resume, cancel, and a file that is closed and opened again. Real workers.

Arguments: worker's Python, capture, folder, tiny_runs.py (the worker's command line with small networks).
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import bpy
import numpy as np
from operation_scene import say

import chona_blender
from chona_blender import commands, jobs, pictures, preferences, train_data, train_queue, train_rows
from chona_blender.errors import ChonaError
from chona_blender.train_view import PICTURE

python, capture, folder, small = sys.argv[1:5]
STEPS = 12
chona_blender.register()
preferences._override["python"] = python
train_queue.chona_command = lambda found, words: [str(found), small, *words, "--progress", "json"]
answer: dict = {}


def scene_settings() -> bpy.types.PropertyGroup:
    """Of the file that is open."""
    return bpy.context.scene.chona


def add(name: str) -> None:
    """A training into a folder of this name."""
    settings = scene_settings()
    settings.data_folder, settings.data_format = capture, "blender"
    settings.run_folder, settings.train_steps, settings.preview_every = str(Path(folder) / name), STEPS, 0.01
    train_queue.add(bpy.context.scene)


def states() -> list[list[str]]:
    """The list as the panel shows it."""
    return [[row.name, row.state] for row in train_rows.rows()]


def error_of(call: object) -> str:
    """The words of an error."""
    try:
        call()
    except ChonaError as error:
        return str(error)
    return ""


def wait_for(steps: int, run: Path) -> None:
    """Until a training has made some steps."""
    while not (run / "log.jsonl").is_file() or len((run / "log.jsonl").read_text().splitlines()) < steps:
        time.sleep(0.005)


def pause_after(steps: int, run: Path) -> None:
    """What a click on Pause does while the training goes on."""
    wait_for(steps, run)
    jobs.board.last.pause()


bpy.ops.wm.read_factory_settings(use_empty=True)
answer["nothing"] = [bpy.ops.chona.train.poll(), bpy.ops.chona.resume_training.poll(), states()]
for name in ("one", "two", "three", "four"):
    add(name)
answer["twice"] = error_of(lambda: add("two"))
scene_settings().data_folder = str(Path(folder) / "nowhere")
answer["no data"] = error_of(lambda: train_queue.add(bpy.context.scene))
train_rows.select(train_rows.rows()[3].key)
bpy.ops.chona.move_training(by=-1)
answer["moved"] = states()
bpy.ops.chona.cancel_training()
answer["cancelled"] = states()
train_rows.select(train_rows.rows()[3].key)
bpy.ops.chona.remove_training()

threading.Thread(target=pause_after, args=(2, Path(folder) / "one"), daemon=True).start()
answer["run"] = list(bpy.ops.chona.run_trainings())
paused = train_rows.rows()[0]
answer["paused"] = {
    "states": states(), "share": paused.share, "words": paused.words, "next": train_queue.next_waiting() is None,
    "files": sorted(path.name for path in (Path(folder) / "one").iterdir()),
}  # fmt: skip
picture = pictures.pixels(PICTURE)
answer["picture"] = [list(picture.shape), float(np.ptp(picture))]

bpy.ops.wm.save_as_mainfile(filepath=str(Path(folder) / "scene.blend"))
bpy.ops.wm.read_factory_settings(use_empty=True)
answer["other file"] = states()
bpy.ops.wm.open_mainfile(filepath=str(Path(folder) / "scene.blend"))
answer["opened"] = states()
train_rows.select(train_rows.rows()[0].key)
answer["use before"] = bpy.ops.chona.use_trained.poll()
answer["resumed"] = list(bpy.ops.chona.resume_training())
answer["done"] = states()
answer["actor"] = scene_settings().model_path
bpy.ops.ed.undo_push(message="before")
scene_settings().minutes, train_rows.rows()[2].words = 77.0, "in the list"
bpy.ops.ed.undo_push(message="after")
bpy.ops.ed.undo()
answer["undone"] = [scene_settings().minutes, states(), train_rows.rows()[2].words]
answer["again"] = bpy.ops.chona.resume_training.poll()
train_rows.select(train_rows.rows()[1].key)
answer["used"] = [list(bpy.ops.chona.use_trained()), scene_settings().model_path]
add("closed")
job = train_queue.start(train_queue.next_waiting())
wait_for(1, Path(folder) / "closed")
job.close()  # as Blender does when it quits, or opens another file
answer["closed"] = [job.status, states()[-1], train_queue.has_checkpoint(train_rows.rows()[-1]), job.remedy]
train_rows.select(train_rows.rows()[-1].key)
bpy.ops.chona.remove_training()
train_rows.rows()[1].state = train_rows.RUNNING  # as a file that is saved while one runs
text = train_rows.as_text()
train_rows.from_text(text)
answer["was running"] = states()
train_rows.from_text('[{"key": 1}, {"state": "NONSENSE"}, 3]')
answer["damaged"] = states()
train_rows.from_text("{")

scene_settings().base_model, scene_settings().identities = str(Path(folder) / "none.safetensors"), ""
answer["no base"] = error_of(lambda: add("added"))
scene_settings().base_model = str(Path(folder) / "one" / "model.safetensors")
answer["nobody"] = error_of(lambda: add("added"))
scene_settings().identities = "Sub01=Ann, box01=Crate"
add("added")
answer["added"] = [list(bpy.ops.chona.run_trainings()), [row.state for row in train_rows.rows()][-1]]
train_rows.from_text("{")
scene_settings().base_model = ""

scene_settings().data_folder, scene_settings().data_format = capture, "auto"
answer["checked"] = list(bpy.ops.chona.check_data())
found, shown = train_data.found(bpy.context.scene), train_data.shown_sheet(bpy.context.scene)
answer["found"] = [found.headline, list(found.warnings), found.sound, shown[0], shown[1].name, shown[1].joints_inside]
sheet = pictures.pixels(train_data.PICTURE)
answer["sheet"] = [list(sheet.shape), float(np.ptp(sheet)), shown[1].sheet.is_file()]
answer["opened sheet"] = [list(bpy.ops.chona.open_sheet()), shown[1].sheet.name in bpy.data.images]
answer["next sheet"] = list(bpy.ops.chona.next_sheet())
answer["command"] = commands.main(
    ["check-data", "--data", capture, "--python", python, "--pictures", str(Path(folder) / "sheets")]
)
answer["bad command"] = commands.main(["check-data", "--data", folder, "--python", python])
chona_blender.unregister()
answer["gone"] = not shown[1].sheet.exists()
say(answer)

"""The worker of a training is killed, and Resume goes on. Arguments: worker's Python, capture, folder, tiny_runs.py."""

from __future__ import annotations

import atexit
import os
import signal
import sys
from pathlib import Path

import bpy
import steady_stage as stage
from operation_scene import say

import chona_blender
from chona_blender import jobs, messages, preferences, train_queue, train_rows
from chona_blender.operators import train

python, capture, folder, small = sys.argv[1:5]
STEPS = 12
answer: dict = {}
train_queue.chona_command = lambda found, words: [str(found), small, *words, "--progress", "json"]


class STEADY_OT_run_trainings(train.CHONA_OT_run_trainings):
    """Trainings as with a window: Blender without one only executes operators, and these begin when executed"""

    bl_idname = "chona.steady_trainings"
    bl_label = "Train"

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self.invoke(context, None)


def rows() -> list[list[str]]:
    """The list as the panel shows it."""
    return [[row.name, row.state, row.words] for row in train_rows.rows()]


def has_begun(run: Path) -> bool:
    """Whether some steps were made, and a checkpoint written."""
    log = run / "log.jsonl"
    return (run / train_queue.CHECKPOINT).is_file() and len(log.read_text().splitlines()) > 2


chona_blender.register()
bpy.utils.register_class(STEADY_OT_run_trainings)
atexit.register(bpy.utils.unregister_class, STEADY_OT_run_trainings)
preferences._override["python"] = python
settings = bpy.context.scene.chona
for name in ("one", "two"):
    settings.data_folder, settings.data_format = capture, "blender"
    settings.run_folder, settings.train_steps = str(Path(folder) / name), STEPS
    train_queue.add(bpy.context.scene)
bpy.ops.chona.steady_trainings()
job = jobs.running()
stage.tick_until(lambda: has_begun(Path(folder) / "one") or job.status != jobs.RUNNING)
os.kill(job.worker._process.pid, signal.SIGKILL)
answer["killed"] = [stage.finish(), job.status, messages.last_error(), rows()]
answer["left"] = [stage.children(), stage.timers(), jobs.running() is None]
train_rows.select(train_rows.rows()[0].key)
answer["resume"] = bpy.ops.chona.resume_training.poll()
train_queue.resume(train_rows.rows()[0])  # as the button; Blender forgets the operator that one here is made from
answer["resumed"], answer["told when it runs again"] = [], []
while train_queue.next_waiting() is not None:
    bpy.ops.chona.steady_trainings()
    answer["told when it runs again"].append(messages.last_error())
    answer["resumed"].append(stage.finish())
answer["rows"] = rows()
say(answer)

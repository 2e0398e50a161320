"""The add-on on and off fifty times, also while it works. Arguments: model, worker's Python, folder."""

from __future__ import annotations

import gc
import sys
import time
from pathlib import Path

import bpy
import steady_stage as stage
from operation_scene import say

import chona_blender
from chona_blender import jobs, live, messages, model_cache, ring_view

model, folder = Path(sys.argv[1]), Path(sys.argv[3])
stage.worker_python()
ROUNDS, WARM = 50, 10
answer: dict = {"rounds": [], "working": []}


def preview_on() -> None:
    """The live preview, with its first picture."""
    bpy.ops.chona.live_preview()
    end = time.monotonic() + stage.PATIENCE
    while live.preview.canvas.is_empty and time.monotonic() < end:
        live.preview.tick()
        time.sleep(0.01)


def work(number: int) -> None:
    """Something is under way when the add-on is switched off; nothing in most rounds."""
    ring_view.switch(bpy.context.scene, True)
    if number in {5, 15}:
        stage.register()
        if number == 5:
            stage.begin_bake()  # a worker that stands still, as one that hangs
        else:
            bpy.ops.chona.steady_bake()
    elif number == 10:
        preview_on()
    elif number == 20:
        bpy.ops.chona.live_preview()
    if number <= 20 and number % 5 == 0:
        answer["working"].append([len(stage.children()), jobs.running() is not None, live.preview.is_on])


def disable(number: int) -> None:
    """As Blender's preferences do."""
    chona_blender.unregister()
    if number in {5, 15}:
        stage.unregister()


chona_blender.register()
stage.furnish(model, folder / "frames")
chona_blender.unregister()
answer["clean"] = stage.left()
for number in range(1, ROUNDS + 1):
    chona_blender.register()
    answer["on"] = [len(stage.classes()), stage.handlers(), stage.drawing()]
    model_cache.refresh(str(model))
    work(number)
    disable(number)
    if number % 5 == 0:
        answer["rounds"].append(stage.left())
    if number == WARM + 10:
        gc.collect()
        answer["held"] = [stage.memory(), stage.open_files()]
gc.collect()
answer["held"] += [stage.memory(), stage.open_files()]
chona_blender.register()
stage.register()
bpy.ops.chona.steady_bake()
answer["bake"] = [stage.finish(), stage.names_in(folder / "frames")]
answer["last"] = [jobs.board.last.status, messages.last_error()]
images = [each.name for each in bpy.data.images]
bpy.ops.chona.steady_bake(current=True)
answer["current"] = [stage.finish(), images == [each.name for each in bpy.data.images]]
say(answer)

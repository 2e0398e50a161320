"""What happens to scene, file and worker while a bake runs. Arguments: model, worker's Python, folder.

Before anything happens a bake's worker is made to stand still, so that it cannot be done too early.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import bpy
import steady_stage as stage
from operation_scene import say

import chona_blender
from chona_blender import compositing, jobs, messages

model, folder = Path(sys.argv[1]), Path(sys.argv[3])
stage.worker_python()
answer: dict = {}


def outcome(job: jobs.Job, result: list[str]) -> dict:
    """How a bake has ended, and what of it is left."""
    return {
        "result": result, "status": job.status, "error": job.error, "told": messages.last_error(), "done": job.done,
        "running": jobs.running() is not None, "timers": stage.timers(), "children": stage.children(),
        "said": job.result,
    }  # fmt: skip


def scene_changes() -> None:
    """Undone and redone, renamed, with another in its name's place, baked elsewhere, its rig and object deleted."""
    scene = stage.furnish(model, folder / "changed")
    scene.chona.composite_after, name, number = True, scene.name, scene.session_uid
    bpy.ops.ed.undo_push(message="before")
    scene.chona.armature.location.y = 0.7
    bpy.ops.ed.undo_push(message="after")
    job = stage.begin_bake()
    answer["undone"] = [sorted(bpy.ops.ed.undo()), sorted(bpy.ops.ed.redo())]
    scene = bpy.context.scene
    scene.name = "Renamed"
    other = bpy.data.scenes.new(name)
    scene.chona.output_folder, scene.chona.name = str(folder / "elsewhere"), "run"
    bpy.data.objects.remove(scene.chona.objects[0].empty)
    bpy.data.objects.remove(scene.chona.armature)
    stage.go_on(job)
    answer["changed"] = outcome(job, stage.finish()) | {
        "same scene": bpy.context.scene.session_uid == number,
        "layers": [compositing.layer_names(scene), compositing.layer_names(other)],
        "elsewhere": stage.names_in(folder / "elsewhere"),
    }


def scene_and_model_go() -> None:
    """The scene is deleted; the model's file is written over, cut off, and gone for a while."""
    stage.furnish(model, folder / "replaced")
    content, other = model.read_bytes(), model.with_name("other.safetensors").read_bytes()
    bpy.data.scenes.new("Stays")
    job = stage.begin_bake()
    bpy.data.scenes.remove(bpy.context.scene)
    model.write_bytes(content[: len(content) // 2])
    model.write_bytes(other)
    stage.go_on(job)
    answer["replaced"] = outcome(job, stage.finish())
    model.write_bytes(content)


def worker_is_killed() -> None:
    """In the middle; the same bake goes on with the rest, and nothing is rendered twice."""
    out = folder / "killed"
    stage.furnish(model, out)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    job = stage.begin_bake(3)
    os.kill(job.worker._process.pid, signal.SIGKILL)
    answer["killed"] = outcome(job, stage.finish()) | {"names": stage.names_in(out)}
    bpy.ops.chona.steady_bake()
    answer["gone on"] = outcome(jobs.board.last, stage.finish())


def another_file() -> None:
    """Opened while a bake runs; reverted and replaced by the factory's while one starts."""
    scene = bpy.context.scene
    scene.chona.output_folder = str(folder / "opened")
    job = stage.begin_bake()
    stage.go_on(job)
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    answer["opened"] = outcome(job, []) | {"folder": bpy.context.scene.chona.output_folder}
    for name, leave in (("reverted", bpy.ops.wm.revert_mainfile), ("factory", bpy.ops.wm.read_factory_settings)):
        messages.remember_error("")
        bpy.context.scene.chona.output_folder = str(folder / name)
        assert bpy.ops.chona.steady_bake() == {"RUNNING_MODAL"}
        job = jobs.board.last
        leave()
        answer[name] = outcome(job, [])


chona_blender.register()
stage.register()
scene_changes()
bpy.ops.wm.read_factory_settings()
scene_and_model_go()
bpy.ops.wm.read_factory_settings()
worker_is_killed()
another_file()
say(answer)

"""Estimates, presets and measurements with real workers. Arguments: model, capture, worker's Python, a free folder."""

from __future__ import annotations

import contextlib
import io
import json
import os
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
from mathutils import Matrix
from operation_scene import say

import chona_blender
from chona_blender import actions, commands, cost_table, estimates, jobs, measuring, model_cache, presets
from chona_blender.errors import ChonaError

model, capture, python, folder = (Path(part) for part in sys.argv[1:5])
os.environ["CHONA_WORKER_PYTHON"] = str(python)
answer: dict = {}


def scene_with_rig() -> bpy.types.Scene:
    """The rig before the camera, four frames with a bone that turns."""
    scene = bpy.context.scene
    for each in list(bpy.data.objects):
        if each.type != "CAMERA":
            bpy.data.objects.remove(each)
    scene.camera.matrix_basis = Matrix(((1, 0, 0, 0), (0, 0, -1, -3), (0, 1, 0, 0.2), (0, 0, 0, 1)))
    scene.render.resolution_x, scene.render.resolution_y = 48, 36
    scene.frame_start, scene.frame_end = 1, 4
    scene.chona.model_path, scene.chona.output_folder = str(model), str(folder / "frames")
    scene.chona.composite_after = False
    bpy.ops.chona.create_rig()
    bone = scene.chona.armature.pose.bones[1]
    bone.rotation_mode = "XYZ"
    for frame, turn in ((1, 0.0), (4, 0.5)):
        bone.rotation_euler.x = turn
        bone.keyframe_insert("rotation_euler", frame=frame)
    return scene


def table() -> dict:
    """What the panel would draw."""
    made = cost_table.table(bpy.context.scene)
    rows = {row.name: [row.quality, row.frame, row.total] for row in made.rows}
    return {"rows": rows, "note": made.note, "stale": made.stale, "problem": made.problem}


def error_of(work: Callable[[], object]) -> str:
    """The words of what goes wrong."""
    try:
        work()
    except (ChonaError, RuntimeError) as error:
        return str(error)
    return ""


def words_of_formats() -> None:
    """Times and qualities as they are said."""
    seconds = (0.004, 0.04, 0.0996, 0.8, 9.94, 9.96, 12.4, 59.6, 200.0, 569.0, 580.0, 3560.0, 3599.7, 3900.0, 90000.0)
    answer["times"] = [estimates.time_words(each) for each in seconds]
    answer["frame times"] = [estimates.frame_words(each) for each in (0.8, 9.96, 64.6, 599.0, 605.0)]
    answer["qualities"] = [estimates.quality_words(each) for each in ({"psnr": 31.24}, {"psnr": None}, None)]
    one = estimates.Estimate(estimates.facts_of(bpy.context.scene), 250, {"final": estimates.Cost(0.8, 200.4)})
    answer["sentences"] = [estimates.sentence("final", trade, one) for trade in (MEASURED, None)]


MEASURED = {"presets": {"final": {"seconds": 1.0, "psnr": 31.2, "ssim": 0.98}}, "size": [512, 384]}


def without_trade(scene: bpy.types.Scene) -> None:
    """A model that nobody measured: nothing, then times without qualities."""
    answer["unmeasured"] = table()
    answer["estimated"] = list(bpy.ops.chona.estimate())
    answer["unmeasured, estimated"] = table()
    job = jobs.board.last
    answer["shot is gone"] = not Path(job.worker.command[job.worker.command.index("--shot") + 1]).exists()
    answer["frames"] = estimates.last(scene).frames
    answer["not shown yet"] = error_of(bpy.ops.chona.show_trade)


def cancelled(scene: bpy.types.Scene) -> None:
    """Cancelled while the worker starts; nothing is left, and what was known stays."""
    job = measuring.start_estimate(scene)
    place = Path(job._place.name)
    was_there = place.is_dir()
    job.cancel()
    jobs.run_blocking(job)
    answer["cancelled"] = [job.status, was_there, place.exists(), estimates.last(scene) is not None]


def measured(scene: bpy.types.Scene) -> None:
    """Measure, see the figures, estimate again."""
    scene.chona.data_folder, scene.chona.measure_minutes = str(capture), 0.1
    answer["traded"] = list(bpy.ops.chona.trade())
    trade = model_cache.cached(str(model)).trade
    answer["trade"] = {name: each["psnr"] for name, each in trade["presets"].items()}
    answer["after trade"] = table()
    answer["shown"] = list(bpy.ops.chona.show_trade())
    answer["plot"] = next(list(each.size) for each in bpy.data.images if each.name.startswith("trade"))
    bpy.ops.chona.estimate()
    answer["measured"] = table()


def stale(scene: bpy.types.Scene) -> None:
    """Everything that an estimate depends on, changed and put back."""
    camera, other = scene.camera, bpy.data.objects.new("other", bpy.data.cameras.new("other"))
    armature = scene.chona.armature
    changes: dict[str, tuple[object, str, object]] = {
        "end": (scene, "frame_end", 9),
        "step": (scene, "frame_step", 2),
        "own range": (scene.chona, "frame_range", "CUSTOM"),
        "size": (scene.render, "resolution_percentage", 50),
        "camera": (scene, "camera", other),
        "lens": (camera.data, "lens", 20.0),
        "place": (camera, "location", (0.0, -4.0, 0.2)),
        "object": (scene.chona.objects[0], "use", False),
        "shutter": (scene.render, "use_motion_blur", True),
        "focus": (camera.data.dof, "use_dof", True),
        "samples of sharp frames": (scene.chona.blur, "samples", 5),
        "preset": (scene.chona, "preset", "draft"),
        "frame": (scene, "frame_current", 3),
        "name": (scene.chona, "name", "walk"),
    }
    told = answer["stale"] = {}
    for name, (owner, attribute, value) in changes.items():
        before = getattr(owner, attribute)
        before = before.copy() if hasattr(before, "copy") and attribute == "location" else before
        setattr(owner, attribute, value)
        now = table()
        setattr(owner, attribute, before)
        told[name] = [now["stale"], now["note"], table()["stale"]]
    scene.chona.armature = armature
    stamp = model.stat().st_mtime
    os.utime(model, (stamp + 5, stamp + 5))
    model_cache.refresh(str(model))
    told["model"] = [table()["stale"], table()["note"], False]
    os.utime(model, (stamp, stamp))
    model_cache.refresh(str(model))


def commanded() -> None:
    """The same without operators."""
    said, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
        code = commands.main(["estimate", "--frames", "1-3", "--preset", "draft"])
    answer["command"] = {"code": code, "lines": said.getvalue().splitlines()}
    with contextlib.redirect_stderr(told):
        answer["unknown preset"] = [commands.main(["estimate", "--preset", "nice"]), told.getvalue()]
        answer["wrong bound"] = commands.main(["bake", "--max-error", "2"])
    bpy.context.scene.chona.frame_range = "SCENE"


def own_presets(scene: bpy.types.Scene) -> None:
    """Chosen, saved with the file, deleted, and a bake tried all the same."""
    settings = scene.chona
    others = [presets.folder() / name for name in ("final.json", "#odd.json", "notes.txt")]  # not presets of the user's
    for other in others:
        other.write_text("{}")
    presets.refresh()
    answer["presets"] = presets.names()
    for other in others:
        other.unlink()
    answer["items"] = [item[:2] for item in presets.items(settings, bpy.context)]
    settings.preset = "my own"
    bpy.ops.chona.estimate()
    answer["my own"] = table()["rows"]["my own"]
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "saved.blend"))
    (presets.folder() / "my own.json").unlink()
    bpy.ops.wm.open_mainfile(filepath=str(folder / "saved.blend"))
    settings = bpy.context.scene.chona
    answer["missing"] = [settings.preset, [item[:2] for item in presets.items(settings, bpy.context)]]
    answer["bake with missing"] = error_of(lambda: actions.start_bake(bpy.context.scene))
    answer["forgotten with the file"] = table()["note"]
    settings.preset = "final"
    answer["chosen anew"] = [settings.preset, [item[0] for item in presets.items(settings, bpy.context)]]


def damaged() -> None:
    """A trade that is none: the model can be used, and it is said."""
    content = model.read_bytes()
    length = struct.unpack("<Q", content[:8])[0]
    found = answer["damaged"] = {}
    header = json.loads(content[8 : 8 + length])
    for name, text in {
        "cut": '{"presets": {', "list": "[]", "no figures": '{"presets": {"final": {}}, "size": [4, 4]}',
        "not a number": '{"presets": {"final": {"seconds": NaN, "psnr": 1, "ssim": 1}}, "size": [4, 4]}',
        "words": '{"presets": {"final": {"seconds": "2", "psnr": 1, "ssim": 1}}, "size": [4, 4]}',
        "no size": '{"presets": {}}',
    }.items():  # fmt: skip
        header["__metadata__"]["chona.trade"] = text
        start = json.dumps(header).encode()
        broken = folder / f"{name}.safetensors"
        broken.write_bytes(struct.pack("<Q", len(start)) + start + content[8 + length :])
        bpy.context.scene.chona.model_path = str(broken)
        read = model_cache.load(str(broken))
        found[name] = [read.trade is None, read.trade_problem, table()["problem"], len(read.persons)]
    answer["bake with damaged"] = list(bpy.ops.chona.bake())


def bounded(scene: bpy.types.Scene) -> None:
    """A bake with an error bound says what it has reached."""
    scene.chona.model_path, scene.chona.name, scene.chona.max_error = str(model), "bounded", 0.02
    started = actions.start_bake(scene)
    jobs.run_blocking(started.job)
    answer["bounded"] = [
        started.job.error,
        started.job.result.get("max_error"),
        actions.error_words(started.job.result),
    ]
    most = {"asked": 0.02, "error": 0.05123, "unsettled": 3, "pixels": 727}
    answer["unsettled words"] = actions.error_words({"max_error": most})
    answer["bound"] = started.job.worker.command[started.job.worker.command.index("--max-error") + 1]
    scene.chona.max_error = 0.0
    answer["no bound"] = "--max-error" in _command_of_bake(scene)


def _command_of_bake(scene: bpy.types.Scene) -> list[str]:
    started = actions.start_bake(scene)
    started.job.close()
    return started.job.worker.command


chona_blender.register()
first = scene_with_rig()
answer["default"] = [first.chona.preset, first.chona.max_error]
words_of_formats()
without_trade(first)
cancelled(first)
measured(first)
stale(first)
commanded()
own_presets(first)
damaged()
bounded(bpy.context.scene)
chona_blender.unregister()
answer["left"] = [len(estimates._kept), len(cost_table._last), presets.names() == list(presets.OWN)]
say(answer)

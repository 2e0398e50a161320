"""Gives wrong input to the commands. Arguments: model, model of another version, worker's Python, output folder."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
from operation_scene import empty_scene, say

import chona_blender
from chona_blender import commands

model, other_version, python, folder = (Path(part) for part in sys.argv[1:5])
chona_blender.register()


def ready() -> bpy.types.Scene:
    """A scene with a rig and a camera in which a bake would start."""
    scene = empty_scene()
    with contextlib.redirect_stderr(io.StringIO()):
        assert commands.main(["create-rig", "--model", str(model)]) == 0
    return scene


def unmapped(scene: bpy.types.Scene) -> None:
    scene.chona.armature.data.bones["spine"].name = "something"


def no_empty(scene: bpy.types.Scene) -> None:
    bpy.data.objects.remove(scene.chona.objects[0].empty)


def no_camera(scene: bpy.types.Scene) -> None:
    scene.camera = None


def no_frames(scene: bpy.types.Scene) -> None:
    scene.chona.frame_range = "CUSTOM"
    scene.chona.frame_start, scene.chona.frame_end = 10, 9


def no_model(scene: bpy.types.Scene) -> None:
    scene.chona.model_path = ""


def no_armature(scene: bpy.types.Scene) -> None:
    scene.chona.armature = None


def nothing(scene: bpy.types.Scene) -> None:
    """The scene is right as it is."""


def run(prepare: Callable[[bpy.types.Scene], None], *options: object) -> dict:
    scene = ready()
    prepare(scene)
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        code = commands.main([str(option) for option in options])
    return {"code": code, "said": said.getvalue().strip().splitlines()}


bake = ("bake", "--out", folder, "--python", python)
(folder.parent / "a file").write_text("")
say(
    {
        "missing model": run(nothing, *bake, "--model", folder / "none.safetensors"),
        "no model": run(no_model, *bake),
        "other version": run(nothing, *bake, "--model", other_version),
        "unmapped bone": run(unmapped, *bake),
        "missing empty": run(no_empty, *bake),
        "no armature": run(no_armature, *bake),
        "no camera": run(no_camera, *bake),
        "empty range": run(no_frames, *bake),
        "reversed frames": run(nothing, *bake, "--frames", "9-3"),
        "not frames": run(nothing, *bake, "--frames", "one"),
        "not writable": run(nothing, "bake", "--python", python, "--out", folder.parent / "a file" / "out"),
        "bad name": run(nothing, *bake, "--name", "a/b"),
        "worker without torch": run(nothing, "bake", "--out", folder, "--python", sys.executable),
        "worker missing": run(nothing, "bake", "--out", folder, "--python", folder / "python"),
        "worker is no Python": run(nothing, "bake", "--out", folder, "--python", model),
        "unknown option": run(nothing, *bake, "--colour"),
        "unknown command": run(nothing, "fry"),
        "no command": run(nothing),
        "no frames to composite": run(nothing, "composite", "--out", folder),
        "no layer to remove": run(nothing, "composite", "--remove"),
        "no scene": run(nothing, *bake, "--scene", "none"),
        "object without empty": run(nothing, *bake, "--object", "crate=none"),
        "unknown object": run(nothing, *bake, "--object", "sofa=crate"),
        "save without name": run(nothing, "create-rig", "--model", model, "--save"),
        "no data": run(nothing, "train", "--python", python),
        "data missing": run(nothing, "train", "--python", python, "--data", folder / "none"),
        "check without torch": run(nothing, "check", "--python", sys.executable),
        "help": run(nothing, "--help"),
    }
)

"""Demo stage 3, in Blender: poses the model's own rig in a furnished room, bakes, composites, and renders the original.

The rig is the add-on's; bake and composite go through the add-on's own commands, as on a render farm.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import bpy

import chona_blender
from chona_blender import commands, compositing
from demo.animate import key_performance
from demo.body import BONES, PERSON
from demo.character import build_character
from demo.crate import build_crate
from demo.poses import NOVEL, performance
from demo.room import add_camera, add_lights, build_room, set_render

SHOT = "present"


def main() -> None:
    """Reads the command line, makes the scene and every picture of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--worker-python", type=Path, required=True)
    parser.add_argument("--width", type=int, required=True)
    parser.add_argument("--height", type=int, required=True)
    parser.add_argument("--samples", type=int, required=True)
    parser.add_argument("--frames", type=int, required=True)
    arguments = parser.parse_args()
    chona_blender.register()
    seconds = {}
    start = time.perf_counter()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    add_lights(scene)
    room = build_room(scene)
    set_render(scene, arguments.width, arguments.height, arguments.samples)
    scene.frame_start, scene.frame_end = 1, arguments.frames
    scene.render.fps = 8
    scene.camera = add_camera(scene, "shot", (1.05, -3.0, 1.35), (-0.02, 0.0, 0.9), 36.0)
    blend = arguments.out / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))

    _command("create-rig", "--model", arguments.model)
    settings = scene.chona
    carrier = settings.objects[0].empty
    # The add-on stands the armature with its feet on the floor; the performance says where the pelvis goes.
    key_performance(settings.armature, carrier, performance(NOVEL), range(1, arguments.frames + 1), BONES)
    seconds["scene"] = time.perf_counter() - start

    start = time.perf_counter()
    _command(
        "bake", "--out", arguments.out / "frames", "--name", SHOT, "--preset", "final", "--overwrite", "--composite",
        "--python", arguments.worker_python,
    )  # fmt: skip
    seconds["bake"] = time.perf_counter() - start
    start = time.perf_counter()
    _render(scene, arguments.out / "composite")
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    seconds["composite"] = time.perf_counter() - start

    start = time.perf_counter()
    compositing.remove_layer(scene, SHOT)
    collection = bpy.data.collections.new("original")
    scene.collection.children.link(collection)
    original, _ = build_character(collection)
    crate, _ = build_crate(collection)
    original.matrix_world = settings.armature.matrix_world.copy()
    key_performance(original, crate, performance(NOVEL), range(1, arguments.frames + 1))
    _render(scene, arguments.out / "reference")
    seconds["reference"] = time.perf_counter() - start
    room.hide_render = True
    (arguments.out / "seconds.json").write_text(json.dumps(seconds))


def _command(*words: str | Path) -> None:
    code = commands.main([str(word) for word in words])
    if code:
        sys.exit(code)


def _render(scene: bpy.types.Scene, folder: Path) -> None:
    """All frames as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    if bpy.app.version >= (5, 0, 0):
        scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(folder / f"{PERSON}_####")
    bpy.ops.render.render(animation=True)


if __name__ == "__main__":
    main()

"""Writes the manual's pages of the add-on, in a Python with bpy: `python scripts/reference/addon_pages.py FOLDER`.

The panels are drawn onto a layout that writes down what they show, with a small scene in which nothing is hidden; what
no panel shows is listed on its own. The pages are the same in every version of Blender.
"""

from __future__ import annotations

import json
import struct
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import bpy  # noqa: E402
from argument_pages import command_page  # noqa: E402
from operator_pages import operators_page  # noqa: E402
from panel_pages import panels_page  # noqa: E402
from tables import write_page  # noqa: E402

import chona_blender  # noqa: E402
from chona_blender import command_line, commands  # noqa: E402

WORDS = """The add-on without a window, on the open file:

    blender --background scene.blend --command chona bake --frames 1-50

Options replace the scene's settings for this run; the file is saved only by `--save`. Exit codes: 0 done, 1 failed or
cancelled, 2 wrong arguments or input, with one line on stderr. With Blender as a Python module the same is
`chona_blender.commands.main(["bake", …])`."""

JOINTS = {"hips": (0.0, 0.9, 0.0), "chest": (0.0, 1.3, 0.0), "head": (0.0, 1.6, 0.0)}


def main(folder: Path) -> None:
    """Three pages."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    chona_blender.register()
    with tempfile.TemporaryDirectory() as scratch:
        furnish(bpy.context.scene, Path(scratch) / "model.safetensors")
        page, shown = panels_page()
        write_page(folder / "panels.md", page)
        write_page(folder / "operators.md", operators_page(shown))
    parser = command_line.make_parser(commands.RUNS)
    page = command_page(parser, "Command blender --command chona", WORDS, "blender … --command chona")
    write_page(folder / "blender-chona.md", page)
    chona_blender.unregister()


def furnish(scene: bpy.types.Scene, model: Path) -> None:
    """Two actors of a model with rigs, and the settings that show further ones."""
    write_header(model)
    scene.chona.first_model = str(model)
    bpy.ops.chona.create_rig()
    bpy.ops.chona.actor_add()
    bpy.ops.chona.create_rig()
    scene.chona.frame_range = scene.chona.capture_range = "CUSTOM"


def write_header(path: Path) -> None:
    """A model file with a person and an object, and without networks: all that the add-on reads."""
    description = {
        "format": "chona-model", "version": 1, "method": "chona", "field": "grid",
        "skeleton": {"names": list(JOINTS), "parents": [-1, 0, 1]},
        "persons": {"Robin": {"rest_joints": list(JOINTS.values())}},
        "objects": {"crate": {"lower": [-0.2, -0.2, -0.2], "upper": [0.2, 0.2, 0.2]}},
        "object_distance": 1.5, "settings": {}, "training": {},
    }  # fmt: skip
    header = json.dumps({"__metadata__": {"chona": json.dumps(description)}}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

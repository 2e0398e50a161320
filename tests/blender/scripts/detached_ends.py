"""What is told of bakes and trainings that have ended while Blender was closed.

Arguments: JSON of places: name of a bake and its folder, or an empty name and a training's.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
from operation_scene import say

import chona_blender
from chona_blender import messages, pick_up, train_rows

chona_blender.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
told: list[dict] = []
for name, folder in json.loads(sys.argv[1]):
    scene = bpy.context.scene
    scene.chona.name, scene.chona.output_folder, scene.chona.run_folder = name or "none", folder, ""
    train_rows.trainings().rows.clear()
    if not name:
        scene.chona.output_folder = ""
        row = train_rows.trainings().rows.add()
        row.key, row.name, row.run_folder, row.state = "k", "run", folder, train_rows.PAUSED
    messages.forget()
    result = list(bpy.ops.chona.pick_up())
    told.append(
        {
            "result": result, "error": messages.last_error(), "news": list(messages.news()),
            "left": sorted(path.name for path in Path(folder).glob(".chona-*")),
            "rows": [[row.state, row.words] for row in train_rows.rows()],
            "dismiss": bpy.ops.chona.dismiss_news.poll(),
        }
    )  # fmt: skip
bpy.context.scene.chona.output_folder = "/nowhere/at/all"
pick_up.look_now()
say({"told": told, "nowhere": pick_up.is_waiting()})
chona_blender.unregister()

"""Writes a shot through the command, as a farm's first task does. Arguments: model, output folder."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path

import numpy as np
from operation_scene import empty_scene, say

import chona_blender
from chona_blender import commands

model, folder = (Path(part) for part in sys.argv[1:3])
chona_blender.register()
scene = empty_scene()
with contextlib.redirect_stderr(io.StringIO()):
    assert commands.main(["create-rig", "--model", str(model)]) == 0
rig = scene.chona.armature
for frame in (1, 9):
    rig.location.x = 0.1 * frame
    rig.keyframe_insert("location", frame=frame)
for curve in rig.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
    for point in curve.keyframe_points:
        point.interpolation = "LINEAR"

told, said = io.StringIO(), io.StringIO()
# No worker could start: this is no Python.
with contextlib.redirect_stdout(told), contextlib.redirect_stderr(said):
    code = commands.main(["shot", "--out", str(folder), "--name", "walk", "--frames=-2-5:2", "--motion-blur", "off"])
    refused = commands.main(
        ["shot", "--out", str(folder), "--name", "walk", "--model", str(folder / "none.safetensors")]
    )
with np.load(folder / "walk.shot.npz", allow_pickle=False) as shot:
    say(
        {
            "codes": [code, refused],
            "told": told.getvalue(),
            "said": said.getvalue(),
            "frames": shot["frames"].tolist(),
            "header": json.loads(shot["header"].tobytes()),
            "root": shot["actor.0.world_from_bone"][:, 0, 0, 3].tolist(),
            "files": sorted(path.name for path in folder.iterdir()),
        }
    )

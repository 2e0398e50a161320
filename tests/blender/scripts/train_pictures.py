"""Curves and pictures of the panel, made of files alone. Argument: folder with ``*.jsonl`` and ``truth.png``.

Writes every picture as an array beside its log.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from operation_scene import say

import chona_blender
from chona_blender import pictures, train_view
from chona_blender.train_log import draw_curves, read_log

folder = Path(sys.argv[1])
chona_blender.register()
images = len(bpy.data.images)
answer: dict = {"lines": {}}
for path in sorted(folder.glob("*.jsonl")):
    log = read_log(path)
    answer["lines"][path.stem] = len(log.step)
    np.save(path.with_suffix(".npy"), draw_curves(log, (200, 160)))
answer["missing"] = len(read_log(folder / "nothing.jsonl").step)

truth = pictures.read(folder / "truth.png")
np.save(folder / "truth.npy", truth)
np.save(folder / "composed.npy", train_view.compose(truth, read_log(folder / "level.jsonl"), 100))
shown = np.random.default_rng(0).random((20, 30, 3))
pictures.show("test", shown)
np.save(folder / "shown.npy", shown)
np.save(folder / "icon.npy", pictures.pixels("test"))
np.save(folder / "shrunk.npy", pictures.shrunk(shown, 10))
pictures.forget("test")
answer["forgotten"] = [pictures.pixels("test") is None, pictures.icon("test")]

run = folder / "run"
run.mkdir()
view = train_view.TrainView(run)
train_view.choose(run)
answer["empty"] = pictures.pixels(train_view.PICTURE) is None
(run / "log.jsonl").write_text((folder / "level.jsonl").read_text())
view.follow()
answer["curves alone"] = pictures.pixels(train_view.PICTURE) is not None
before = pictures.pixels(train_view.PICTURE)
(run / "preview.png").write_bytes((folder / "truth.png").read_bytes())
view.follow(force=True)
answer["with a preview"] = float(np.abs(pictures.pixels(train_view.PICTURE) - before).max())
train_view.choose(None)
answer["none chosen"] = pictures.pixels(train_view.PICTURE) is None
answer["images"] = len(bpy.data.images) - images
chona_blender.unregister()
say(answer)

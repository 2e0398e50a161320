"""A bake through the real `chona` with a model whose tensors are missing. Arguments: model, worker's Python, folder."""

from __future__ import annotations

import contextlib
import io
import sys

from operation_scene import empty_scene, say

import chona_blender
from chona_blender import commands, jobs

model, python, folder = sys.argv[1:4]
chona_blender.register()
empty_scene()
words = io.StringIO()
with contextlib.redirect_stderr(words):
    commands.main(["create-rig", "--model", model])
    code = commands.main(["bake", "--out", folder, "--python", python, "--frames", "1-2", "--preset", "draft"])
say({"code": code, "words": words.getvalue(), "report": jobs.board.last.report})

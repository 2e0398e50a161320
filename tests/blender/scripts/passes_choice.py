"""Passes chosen by the panel's settings and by the command's option; what the worker is told."""

from __future__ import annotations

import contextlib
import io
import sys

from operation_scene import empty_scene, say

import chona_blender
from chona_blender import actions, commands, jobs, preferences

model, out, worker = sys.argv[1:4]
chona_blender.register()
scene = empty_scene()
settings = scene.chona
answer: dict = {"default": settings.passes.names()}


def said(*words: str) -> tuple[int, str]:
    """Exit code and stderr of a command."""
    with contextlib.redirect_stderr(io.StringIO()) as stream:
        code = commands.main(words)
    return code, stream.getvalue()


answer["unknown"] = said("bake", "--passes", "normals")
answer["no depth"] = said("bake", "--passes", "combined,normal", "--composite")
assert commands.main(["create-rig", "--model", model]) == 0
settings.passes.choose(["normal", "cryptomatte"])
settings.output_folder = out
with preferences.overridden(python=worker):
    jobs.run_blocking(actions.start_bake(scene).job, lambda _job: None)
say(answer)
chona_blender.unregister()

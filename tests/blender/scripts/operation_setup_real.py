"""Sets the worker up with the real packages from pip's configured index. Argument: the zip."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path

import bpy
from operation_scene import say

sys.path[:] = [part for part in sys.path if not (Path(part) / "chona_blender").is_dir()]
name = "bl_ext.user_default.chona"
bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
bpy.context.preferences.system.use_online_access = True
words = io.StringIO()
with contextlib.redirect_stdout(words), contextlib.redirect_stderr(words):
    code = sys.modules[f"{name}.commands"].main(["setup-worker", "--device", "cpu"])
answer = {"code": code, "words": words.getvalue()}
if code == 0:
    worker = sys.modules[f"{name}.worker"]
    command = [str(worker.find_python()[0]), "-m", "chona_model", "doctor", "--json"]
    done = subprocess.run(command, env=worker.worker_environment(), capture_output=True, text=True, check=False)
    answer["doctor"] = json.loads(done.stdout)
say(answer)

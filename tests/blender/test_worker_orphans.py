"""Blender is killed while a bake runs: the worker ends with it, its frames are whole, and a new bake goes on."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from operation_helpers import ROOT, SCRIPTS, bpy_pythons, needs_worker

pytestmark = [pytest.mark.bpy, pytest.mark.faults]
FRAMES = 400
PROMISED_SECONDS = 5.0


@pytest.mark.skipif(sys.platform == "win32", reason="looks for processes as Linux and macOS do")
@pytest.mark.parametrize("python", bpy_pythons()[:1])
def test_a_worker_ends_with_a_blender_that_crashes(python: str, tmp_path: Path) -> None:
    needs_worker(python)
    from rolling_ball import write_rolling_ball

    from chona_model.formats.exr_structure import is_whole
    from chona_model.owner import process_start

    out = tmp_path / "out"
    model, shot = write_rolling_ball(tmp_path, FRAMES)
    words = ["bake", "--model", str(model), "--shot", str(shot), "--out", str(out)]
    variables = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    variables["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(SCRIPTS)])
    with subprocess.Popen(
        [python, str(SCRIPTS / "worker_orphan.py"), sys.executable, *words],
        stdout=subprocess.PIPE, text=True, env=variables,
    ) as blender:  # fmt: skip
        assert blender.stdout is not None
        told = json.loads(next(line for line in blender.stdout if line.startswith("{")))
        blender.kill()
    assert told["error"] == ""
    began = time.monotonic()
    while process_start(told["pid"]) is not None:
        assert time.monotonic() - began < PROMISED_SECONDS
        time.sleep(0.02)
    frames = list(out.glob("walk_*.exr"))
    assert 0 <= len(frames) < FRAMES and all(is_whole(path) for path in frames)
    again = subprocess.run(
        [sys.executable, "-m", "chona_model", *words, "--frames", "1-10", "--progress", "json"], cwd=ROOT, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    assert again.returncode == 0, again.stderr
    assert {path.name for path in out.iterdir()} >= {f"walk_{number:04d}.exr" for number in range(1, 11)}
    assert not [path for path in out.iterdir() if path.name.startswith(".")]

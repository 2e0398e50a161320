"""The installed extension in the real Blender, with a window and as a command.

$CHONA_BLENDER is the launcher with its own options, for example `blender` or `xvfb-run blender`; the pictures go to
$CHONA_PICTURES where that is set. Blender must be able to see the repository, this Python and those folders.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from operation_helpers import ROOT, write_header_only_model

pytestmark = pytest.mark.blender


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where pictures go, with the zip and a model in it."""
    target = Path(os.environ.get("CHONA_PICTURES", tmp_path))
    target.mkdir(parents=True, exist_ok=True)
    for name in ("resources", "frames", "capture"):
        shutil.rmtree(target / name, ignore_errors=True)
    build = [sys.executable, ROOT / "scripts" / "build_extension.py", "--out", target]
    subprocess.run(build, check=True, capture_output=True)
    write_header_only_model(target / "Robin.safetensors")
    return target


def test_sidebar_with_a_window(blender_launcher: list[str], folder: Path) -> None:
    """From an empty home: install, rig, a worker without torch, progress, cancel; with pictures of each step."""
    package = next(folder.glob("chona-*.zip"))
    script = ROOT / "tests" / "blender" / "real_blender_gui.py"
    size = ["--window-geometry", "0", "0", "1280", "860"]
    command = [
        *blender_launcher,
        *size,
        "--python",
        script,
        "--",
        package,
        folder / "Robin.safetensors",
        sys.executable,
        folder,
    ]
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "resources")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=200)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    answer = json.loads((folder / "answer.json").read_text())
    assert answer["enabled"] and answer["rig"] == ["FINISHED"]
    assert "has no torch" in answer["bake without torch"] and "has no torch" in answer["error"]
    assert answer["worker"].startswith("Python 3")
    assert answer["bake"] == ["RUNNING_MODAL"] and "of 50" in answer["while running"]
    assert answer["after escape"] == "CANCELLED"
    assert len(answer["steps"]) == 7 and all((folder / f"{name}.png").is_file() for name in answer["steps"])
    assert answer["capture"] == ["RUNNING_MODAL"]
    assert answer["captured"][0] == "DONE", answer["captured"][1]
    assert (folder / "capture" / "capture.json").is_file() and answer["data folder"] == str(folder / "capture")
    if "--gui" not in blender_launcher:
        return
    # The same home without a window: the command is known, and its exit code is what a farm sees.
    plain = blender_launcher[: blender_launcher.index("--gui")]
    command = [*plain, "--background", "--command", "chona", "bake", "--model", folder / "none.safetensors"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 2, done.stdout + done.stderr
    assert "There is no model file" in done.stderr

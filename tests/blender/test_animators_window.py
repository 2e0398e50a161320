"""The animator's whole job in the real Blender with a window, from an empty home, with a picture of every step.

$CHONA_BLENDER is the launcher with its own options, for example `blender` or `xvfb-run blender`; pictures go to
$CHONA_PICTURES, of the model $CHONA_MODEL, where those are set. Blender must be able to see the repository, this Python
and those folders.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from operation_helpers import ROOT, SCRIPTS, needs_worker
from PIL import Image

pytestmark = [pytest.mark.blender, pytest.mark.slow]
WIDTH = 320
STEPS = (
    "installed", "nothing_set", "model", "mapped", "checked", "stand_in", "live_preview", "estimated",
    "bake_runs", "baked", "compositor", "rendered",
)  # fmt: skip
SECONDS = 1500
"""For everything: the first worker compiles its kernels."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, blender_launcher: list[str]) -> Path:
    """Where pictures and frames are, after the job."""
    target = Path(os.environ.get("CHONA_PICTURES") or tmp_path_factory.mktemp("window"))
    target.mkdir(parents=True, exist_ok=True)
    for name in ("resources", "frames"):
        shutil.rmtree(target / name, ignore_errors=True)
    build = [sys.executable, ROOT / "scripts" / "build_extension.py", "--out", target]
    subprocess.run(build, check=True, capture_output=True)
    command = [
        *blender_launcher, "--window-geometry", "0", "0", "1500", "1060",
        "--python", SCRIPTS / "animators_window.py", "--",
        next(target.glob("chona-*.zip")), model(target), sys.executable, target, str(WIDTH),
    ]  # fmt: skip
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(target / "resources")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=SECONDS)
    words = (target / "answer.json").read_text() if (target / "answer.json").exists() else "no answer"
    assert done.returncode == 0, words + done.stdout[-3000:] + done.stderr[-3000:]
    return target


def model(target: Path) -> Path:
    """$CHONA_MODEL, else the tiny one."""
    if "CHONA_MODEL" in os.environ:
        return Path(os.environ["CHONA_MODEL"])
    needs_worker(sys.executable)
    from tiny_models import trained

    from chona_model.grid_actor import GridActor
    from chona_model.model_store import save_actor

    save_actor(target / "model.safetensors", GridActor(trained()[1].model), "chona", {"preset": "fast"}, {"steps": 1})
    return target / "model.safetensors"


def test_every_step_ends_well(folder: Path) -> None:
    answer = json.loads((folder / "answer.json").read_text())
    assert answer["enabled"] and answer["worker"].startswith("Python 3")
    assert answer["mapped"] == answer["object"] == answer["checked"] == ["FINISHED"]
    assert answer["family"].startswith("Mixamo: ") and "missing" not in answer["family"]
    assert answer["stand-in"] == answer["bake"] == ["RUNNING_MODAL"]
    assert answer["stand-in made"][0] == answer["estimated"][0] == answer["baked"][0] == "DONE"
    assert answer["live line"].startswith("final") and answer["live off"] == ["FINISHED"]
    assert answer["frames"] == [f"handling_{number:04d}.exr" for number in range(1, 11)]
    assert answer["removed"] == ["FINISHED"]
    assert [name.partition("_")[2] for name in answer["pictures"]] == list(STEPS)


def test_pictures_show_something(folder: Path) -> None:
    """Screens and renders are neither empty nor all alike."""
    screens = [np.asarray(Image.open(path).convert("RGB"), dtype=float) for path in sorted(folder.glob("[01]*_*.png"))]
    assert len(screens) == len(STEPS)
    for one, other in pairwise(screens):
        assert one.std() > 10 and (np.abs(one - other).max(axis=-1) > 20).mean() > 0.001


def test_the_figure_is_in_the_render(folder: Path) -> None:
    """Where the bake covers and nothing stands before it, the composite differs from the plate; at the border not."""
    composite, plate = (
        np.asarray(Image.open(folder / f"{name}.png").convert("RGB")) for name in ("composite", "plate")
    )
    assert composite.shape == (WIDTH * 3 // 4, WIDTH, 3)
    alpha = OpenEXR.File(str(folder / "frames" / "handling_0004.exr"), separate_channels=True).channels()
    covered = alpha["CHONA.Combined.A"].pixels > 0.9
    changed = np.abs(composite.astype(int) - plate).max(axis=-1) > 12
    assert covered.mean() > 0.01
    assert changed[covered].mean() > 0.5  # furniture hides a part
    assert changed[:, :10].mean() < 0.02

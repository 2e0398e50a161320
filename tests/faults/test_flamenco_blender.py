"""A whole Flamenco job with the real Blender: shot, bakes, composite, renders, video.

$CHONA_BLENDER is as for tests/blender/test_real_blender.py; it must see this folder and the tests' temporary one.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from farm_scene import CHONA, ROOT, write_scene
from PIL import Image

from chona_model.formats.exr import read_frame

pytestmark = pytest.mark.blender


def program(path: Path, words: list[str]) -> str:
    """A program that runs ``words`` with its own arguments after them, as the Manager's variables name one."""
    path.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
    path.chmod(0o755)
    return str(path)


def test_a_job_from_the_blend_file_to_the_composite(tmp_path: Path, blender_launcher: list[str]) -> None:
    """Where the ball covers a pixel, the rendered composite has the baked frame's colour."""
    pytest.importorskip("dukpy", reason="the engine in which the job type runs; pip install dukpy")
    from flamenco_worker import Manager, find_ffmpeg, in_order, run_task

    model, _ = write_scene(tmp_path, 1)
    scene, out = tmp_path / "scene 1.blend", tmp_path / "frames"
    blender = program(tmp_path / "blender", blender_launcher)
    resources = {"BLENDER_USER_RESOURCES": str(tmp_path / "resources")}

    def run(*words: object) -> None:
        done = subprocess.run(
            list(map(str, words)), env=os.environ | resources, capture_output=True, text=True, check=False, timeout=900
        )
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]

    run(sys.executable, ROOT / "scripts" / "build_extension.py", "--out", tmp_path)
    (package,) = tmp_path.glob("chona-*.zip")
    run(blender, "--command", "extension", "install-file", "-r", "user_default", "--enable", package)
    run(blender, "-b", "--python-exit-code", "1", "--python", ROOT / "tests/blender/scripts/farm_stage.py", "--", model,
        scene, out)  # fmt: skip

    manager = Manager()
    settings = manager.defaults() | {
        "frames": "1-3", "chunk_size": 2, "model": str(model), "output": str(out), "name": "roll", "fps": 24.0,
        "blendfile": str(scene), "render_output_path": str(out / "composited" / "######"), "device": "cpu",
    }  # fmt: skip
    ffmpeg = find_ffmpeg()
    variables = {"chona": program(tmp_path / "chona", CHONA), "blender": blender, "blenderArgs": "-b -y"}
    for task in in_order(manager.compile(settings)):
        if task["type"] != "ffmpeg":
            run_task(task, variables, **resources)
        elif ffmpeg:
            run_task(task, variables | {"ffmpeg": ffmpeg})
            assert (out / "composited" / "roll-1-3.mp4").stat().st_size > 0
    middles = []
    for frame in (1, 2, 3):
        layers, _ = read_frame(out / f"roll_{frame:04d}.exr")
        solid = layers.combined[..., 3] > 0.999
        light = np.clip(layers.combined[..., :3], 0.0, 1.0)
        shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        picture = np.asarray(Image.open(out / "composited" / f"{frame:06d}.png").convert("RGB")) / 255
        assert solid.sum() > 50 and np.abs(picture - shown)[solid].max() < 0.01
        assert picture[layers.combined[..., 3] == 0].max() < 0.01
        middles.append(np.argwhere(solid)[:, 1].mean())
    assert middles[0] + 1 < middles[1] < middles[2] - 1

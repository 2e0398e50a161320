"""A model of a ball that needs no training, a shot of it rolling by, and what a bake of it made."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "model"))

from ball_model import ball_actor  # noqa: E402

from chona_model.formats.exr import read_frame  # noqa: E402
from chona_model.formats.shot import Shot, ShotActor, write_shot  # noqa: E402
from chona_model.model_store import save_actor  # noqa: E402

ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
"""Of a process that finds this source tree."""
CHONA = [sys.executable, "-m", "chona_model"]


def write_scene(
    folder: Path, frames: int, first: int = 1, size: tuple[int, int] = (48, 32), name: str = "roll"
) -> tuple[Path, Path]:
    """The files ``model.safetensors`` and ``NAME.shot.npz``."""
    folder.mkdir(parents=True, exist_ok=True)
    model, path = folder / "model.safetensors", folder / f"{name}.shot.npz"
    save_actor(model, ball_actor(), "chona", {}, {})
    ball = np.tile(np.eye(4), (frames, 1, 1, 1))
    ball[:, 0, 0, 3] = np.linspace(-0.4, 0.4, frames)
    camera, (width, height) = np.eye(4), size
    camera[2, 3] = -1.5
    lens = np.array([[1.5 * height, 0, width / 2], [0, 1.5 * height, height / 2], [0, 0, 1.0]])
    actor = ShotActor("ball", None, ("ball",), (), np.zeros((frames, 0, 4, 4)), ball)
    shot = Shot(
        name, 24.0, width, height, "PERSP", np.arange(first, first + frames), np.tile(lens, (frames, 1, 1)),
        np.tile(camera, (frames, 1, 1)), np.tile([0.01, 100.0], (frames, 1)), (actor,),
    )  # fmt: skip
    write_shot(path, shot)
    return model, path


def baked(model: Path, shot: Path, out: Path) -> Path:
    """The folder of a bake by one process alone, preset draft.

    It has its kernels from the cache, as those have that it is compared with: a process that compiles them itself may
    round the last bit of a depth in another way.
    """
    words = [*CHONA, "bake", "--model", str(model), "--shot", str(shot), "--preset", "draft", "--device", "cpu"]
    with tempfile.TemporaryDirectory() as compiled:
        for folder in (Path(compiled), out):
            subprocess.run([*words, "--out", str(folder)], env=ENVIRONMENT, check=True, capture_output=True)
    return out


def numbers(out: Path) -> set[str]:
    """Names of the frames of a folder, without those that are being written."""
    return {path.name for path in out.glob("[!.]*.exr")}


def watch(out: Path, ended: Callable[[], bool], seconds: float = 500.0) -> None:
    """Waits for the end, and looks on: a frame that is there is never put there again."""
    seen: dict[str, tuple[int, int]] = {}
    until = time.monotonic() + seconds
    over = False
    while not over:
        assert time.monotonic() < until, "it does not end"
        over = ended()  # and one last look
        for name in numbers(out):
            facts = (out / name).stat()
            assert seen.setdefault(name, (facts.st_ino, facts.st_mtime_ns)) == (facts.st_ino, facts.st_mtime_ns), name
        time.sleep(0.02)


def assert_same_frames(out: Path, truth: Path) -> None:
    """The same frames, of the same pixels and the same origin."""
    assert numbers(out) == numbers(truth)
    for path in truth.glob("[!.]*.exr"):
        (layers, header), (ours, its) = read_frame(path), read_frame(out / path.name)
        np.testing.assert_array_equal(ours.combined, layers.combined)
        np.testing.assert_array_equal(ours.depth, layers.depth)
        told = (header.model, header.shot, header.preset, header.settings, header.frame)
        assert (its.model, its.shot, its.preset, its.settings, its.frame) == told
    assert layers.combined[..., 3].max() > 0.9, "the ball is not in the picture"

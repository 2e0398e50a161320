"""Killed with SIGKILL at any moment: resumed, it gives the same model and frames, and nothing half done is left."""

from __future__ import annotations

import json
import random
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FRAMES, STEPS, Scene
from fault_runs import bake_words, finish, names_in, read_until, run, start, tensors_of, train_words

from chona_model.formats.exr import read_frame

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL there"),
]
KILLED = -9
LIVES = 3
"""So often a training or bake is killed before it may end."""

Often = Callable[[int, int], int]


def killed_after(words: list[str], seconds: float) -> None:
    """Starts a program and kills it so long after it began its work, or lets it end before."""
    process = start(words)
    try:
        read_until(process, "start")
        time.sleep(seconds)
    finally:
        process.kill()
        process.communicate()


def killed_at(touch: int, folder: Path, words: list[str]) -> int:
    """Runs a program that is killed before its n-th touch of a file in ``folder``; its exit code."""
    words = words[1:] if words[0].endswith(".py") else words[2:]
    return run([str(Path(__file__).with_name("fault_runs.py")), str(touch), str(folder), *words]).returncode


def resumed(capture: Path, out: Path) -> list[str]:
    """The training that goes on from where the last one was killed."""
    there = (out / "checkpoint.safetensors").exists()
    return train_words(capture, out, STEPS, *(["--resume"] if there else []))


def check_run(out: Path, whole: Path) -> None:
    """The model of an interrupted training is that of the other, and nothing else is left of it."""
    assert tensors_of(out / "model.safetensors") == tensors_of(whole / "model.safetensors")
    assert names_in(out) == {"model.safetensors", "checkpoint.safetensors", "log.jsonl"}
    steps = [json.loads(line)["step"] for line in (out / "log.jsonl").read_text("utf-8").splitlines()]
    assert steps == list(range(1, STEPS + 1)), "every step once"


def check_frames(out: Path, whole: Path) -> None:
    """The frames of an interrupted bake are those of the other, and nothing else is left of it."""
    assert names_in(out) == names_in(whole) and len(names_in(out)) == FRAMES
    for path in whole.iterdir():
        (one, _), (other, _) = read_frame(path), read_frame(out / path.name)
        np.testing.assert_array_equal(one.combined, other.combined)
        np.testing.assert_array_equal(one.depth, other.depth)


@pytest.fixture(scope="module")
def baked(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The frames of a bake that nothing interrupted."""
    out = tmp_path_factory.mktemp("whole")
    finish(bake_words(scene.model, scene.shot, out))
    return out


@pytest.mark.timeout(7200)
def test_a_training_killed_at_random_moments(scene: Scene, tmp_path: Path, often: Often) -> None:
    chance, kills, number = random.Random(1), often(2, 100), 0
    while number < kills:
        out = tmp_path / f"run{number}"
        for _ in range(min(LIVES, kills - number)):
            killed_after(resumed(scene.capture, out), chance.uniform(0.0, 12.0))
            number += 1
        finish(resumed(scene.capture, out))
        check_run(out, scene.run)


@pytest.mark.timeout(7200)
def test_a_training_killed_at_its_files(scene: Scene, tmp_path: Path, often: Often) -> None:
    """Before every file that it opens, renames or removes, one after the other."""
    chance, kills = random.Random(2), often(2, 100)
    touches = range(1, kills + 1) if kills > 40 else [chance.randint(1, 40) for _ in range(kills)]
    for touch in touches:
        out = tmp_path / f"run{touch}"
        code = killed_at(touch, out, train_words(scene.capture, out, STEPS))
        assert code in (KILLED, 0)
        finish(resumed(scene.capture, out))
        check_run(out, scene.run)


@pytest.mark.timeout(7200)
def test_a_bake_killed_at_random_moments(scene: Scene, baked: Path, tmp_path: Path, often: Often) -> None:
    chance, kills, number = random.Random(3), often(2, 100), 0
    while number < kills:
        out = tmp_path / f"out{number}"
        for _ in range(min(LIVES, kills - number)):
            killed_after(bake_words(scene.model, scene.shot, out), chance.uniform(0.0, 1.5))
            number += 1
        finish(bake_words(scene.model, scene.shot, out))
        check_frames(out, baked)


@pytest.mark.timeout(7200)
def test_a_bake_killed_at_its_files(scene: Scene, baked: Path, tmp_path: Path, often: Often) -> None:
    """Before every file that it opens, renames or removes; what is finished by then is not rendered again."""
    chance, kills = random.Random(4), often(3, 100)
    touches = (
        [1 + number % 50 for number in range(kills)] if kills > 40 else [chance.randint(6, 40) for _ in range(kills)]
    )
    for number, touch in enumerate(touches):
        out = tmp_path / f"out{number}"
        words = bake_words(scene.model, scene.shot, out)
        assert killed_at(touch, out, words) in (KILLED, 0)
        there = {path.name for path in out.glob("walk*.exr")} if out.exists() else set()
        told = finish(words)
        assert told["skipped"] == len(there) and told["written"] == FRAMES - len(there)
        check_frames(out, baked)

"""Killed with SIGKILL at any moment: resumed, it gives the same model and frames, and nothing half done is left."""

from __future__ import annotations

import json
import random
import sys
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from fault_runs import bake_words, finish, names_in, read_until, start, tensors_of
from fault_scene import FRAMES, STEPS, Scene

from chona_model.formats.exr import read_frame

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL there"),
    pytest.mark.timeout(7200),
]
KILLED = -9
LIVES = 3
"""So often a training or bake is killed before it may end."""
TRAIN_SECONDS, BAKE_SECONDS = 2.0, 0.8
"""Latest moment of a kill after the work has begun."""
TRAIN_TOUCHES, BAKE_TOUCHES = 60, 70
"""Latest file at which a kill is tried, counted from the start; a whole training and bake touch about as many."""

Often = Callable[[int, int], int]


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


def killed_at_random(
    scene: Scene, words: Callable[[Path], list[str]], within: float, kills: int, folder: Path, seed: int
) -> Iterator[Path]:
    """Folders of work that was killed ``LIVES`` times and then let end, each a new one, until ``kills`` came in time.

    Args:
        words: of the program, by its folder; within: seconds after its begin.
    """
    chance, done = random.Random(seed), 0
    for turn in count():
        if done >= kills:
            return
        out = folder / str(turn)
        for _ in range(LIVES):
            child = scene.nursery.start(words(out))
            child.wait_for("start")
            time.sleep(chance.uniform(0.0, within))
            done += child.kill() == KILLED
        scene.nursery.start(words(out)).finish()
        yield out


def test_a_training_killed_at_random_moments(scene: Scene, tmp_path: Path, often: Often) -> None:
    for out in killed_at_random(scene, scene.train, TRAIN_SECONDS, often(4, 100), tmp_path, 1):
        check_run(out, scene.run)


def test_a_training_killed_at_its_files(scene: Scene, tmp_path: Path, often: Often) -> None:
    """Before a file that it makes, writes, renames or removes: all of them one after the other where many are tried."""
    for number in range(often(4, 100)):
        out = tmp_path / f"run{number}"
        touch = 1 + number * (often(TRAIN_TOUCHES // 4, 1)) % TRAIN_TOUCHES
        assert scene.nursery.start(scene.train(out), (touch, out)).wait() == KILLED
        scene.nursery.start(scene.train(out)).finish()
        check_run(out, scene.run)


def test_a_bake_killed_at_random_moments(scene: Scene, tmp_path: Path, often: Often) -> None:
    for out in killed_at_random(scene, scene.bake, BAKE_SECONDS, often(6, 100), tmp_path, 3):
        check_frames(out, scene.frames)


def test_a_bake_killed_at_its_files(scene: Scene, tmp_path: Path, often: Often) -> None:
    """What is finished by then is not rendered again."""
    for number in range(often(4, 100)):
        out = tmp_path / f"out{number}"
        touch = 1 + number * (often(BAKE_TOUCHES // 4, 1)) % BAKE_TOUCHES
        assert scene.nursery.start(scene.bake(out), (touch, out)).wait() == KILLED
        there = len(list(out.glob("walk*.exr"))) if out.exists() else 0
        told = scene.nursery.start(scene.bake(out)).finish()
        assert (told["skipped"], told["written"]) == (there, FRAMES - there)
        check_frames(out, scene.frames)


def test_killed_while_it_loads(scene: Scene, tmp_path: Path, often: Often) -> None:
    """A program from its very start, as users start it, and as soon as it says a word."""
    chance = random.Random(5)
    for number in range(often(1, 10)):
        out = tmp_path / f"out{number}"
        words = bake_words(scene.model, scene.shot, out)
        with start(words) as process:
            time.sleep(chance.uniform(0.0, 2.0))
            process.kill()
        with start(words) as process:
            read_until(process, "start")
            process.kill()
        assert finish(words)["job"] == "bake"
        assert len(names_in(out)) == FRAMES

"""Parents that die, impatient users, processes that stand still, and clocks that jump."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fault_nursery import Child
from fault_runs import bake_words, environment, finish, names_in, tensors_of, train_words
from fault_scene import FRAMES, STEPS, Scene
from test_memory import enlarged

from chona_model.formats.exr import read_frame
from chona_model.owner import process_start

pytestmark = [pytest.mark.faults, pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")]

PARENT = """
import subprocess, sys
event, *words = sys.argv[1:]
child = subprocess.Popen([sys.executable, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                         stderr=subprocess.DEVNULL, start_new_session=True, text=True)
while f'"{event}"' not in child.stdout.readline():
    pass
print(child.pid, flush=True)
for line in child.stdout:
    pass
"""
PROMISED_SECONDS = 5.0


def orphaned(words: list[str], event: str) -> int:
    """Starts a program from another that is killed once the first says so; the program's number."""
    with subprocess.Popen(
        [sys.executable, "-c", PARENT, event, *words], stdout=subprocess.PIPE, text=True, env=environment()
    ) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        time.sleep(0.5)
        parent.kill()
    return pid


def seconds_until_gone(pid: int) -> float:
    """How long a process lives on."""
    began = time.monotonic()
    while process_start(pid) is not None:
        assert time.monotonic() - began < 60
        time.sleep(0.02)
    return time.monotonic() - began


def test_a_bake_ends_with_its_parent(scene: Scene, tmp_path: Path) -> None:
    """Also in the middle of a frame that takes minutes."""
    out, shot = tmp_path / "out", enlarged(scene, tmp_path, 200)
    pid = orphaned([*bake_words(scene.model, shot, out, "--preset", "exact"), "--until-closed"], "start")
    assert seconds_until_gone(pid) < PROMISED_SECONDS
    assert not list(out.glob("*.exr"))
    shown = finish([*bake_words(scene.model, scene.shot, out), "--until-closed"])
    assert shown["written"] == FRAMES and len(names_in(out)) == FRAMES


def test_a_training_ends_with_its_parent_and_keeps_its_step(scene: Scene, tmp_path: Path) -> None:
    pid = orphaned([*train_words(scene.capture, tmp_path, 10**6), "--until-closed"], "progress")
    assert seconds_until_gone(pid) < PROMISED_SECONDS
    finish(train_words(scene.capture, tmp_path, 1, "--resume"))
    assert names_in(tmp_path) == {"model.safetensors", "checkpoint.safetensors", "log.jsonl"}


def test_ctrl_c_twice(scene: Scene, tmp_path: Path, often) -> None:
    """Once waits for the frame, which takes long; twice does not."""
    shot = enlarged(scene, tmp_path, 200)
    for number in range(often(1, 20)):
        out = tmp_path / f"out{number}"
        child = scene.nursery.start([*bake_words(scene.model, shot, out)[2:], "--preset", "exact"])
        child.wait_for("start")
        time.sleep(0.5)
        for _ in range(2):
            os.kill(child.pid, signal.SIGINT)
            time.sleep(0.1)
        began = time.monotonic()
        assert child.wait() == 1 and time.monotonic() - began < 10
        assert [event["event"] for event in child.events()] == ["start", "cancelled"] and names_in(out) == set()


def stopped_for(child: Child, seconds: float) -> None:
    os.kill(child.pid, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(child.pid, signal.SIGCONT)


def test_a_bake_that_stood_still_goes_on(scene: Scene, tmp_path: Path) -> None:
    child = scene.nursery.start(scene.bake(tmp_path))
    child.wait_for("start")
    stopped_for(child, 1.0)
    assert child.finish()["written"] == FRAMES
    check_same_frames(tmp_path, scene.frames)


def test_time_that_a_training_stood_still_is_no_training(scene: Scene, tmp_path: Path) -> None:
    """Of six seconds of training none is lost by eight of standing still."""
    words = [*train_words(scene.capture, tmp_path, 1)[1:], "--minutes", "0.1"]
    at = words.index("--steps")
    child = scene.nursery.start(words[:at] + words[at + 2 :])
    child.wait_for("progress")
    stopped_for(child, 8.0)
    done = len((tmp_path / "log.jsonl").read_text("utf-8").splitlines())
    assert child.finish()["seconds"] >= 6.0
    log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text("utf-8").splitlines()]
    assert len(log) > done + 3, "it ended as soon as it went on"
    assert log[-1]["seconds"] < 8.0


def test_clocks_may_jump(scene: Scene, tmp_path: Path) -> None:
    scene.nursery.start(scene.train(tmp_path / "run"), clock_jumps=True).finish()
    assert tensors_of(tmp_path / "run" / "model.safetensors") == tensors_of(scene.model)
    log = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text("utf-8").splitlines()]
    seconds = [line["seconds"] for line in log]
    assert len(log) == STEPS and seconds == sorted(seconds) and 0.0 <= seconds[0] <= seconds[-1] < 300
    told = scene.nursery.start(scene.bake(tmp_path / "out"), clock_jumps=True).finish()
    assert 0.0 <= told["seconds"] < 300
    check_same_frames(tmp_path / "out", scene.frames)


def check_same_frames(out: Path, whole: Path) -> None:
    assert names_in(out) == names_in(whole)
    for path in whole.iterdir():
        np.testing.assert_array_equal(read_frame(path)[0].combined, read_frame(out / path.name)[0].combined)

"""Bakes and trainings that go on when Blender is killed: the next Blender shows them, cancels them, tells their ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from operation_helpers import ROOT, SCRIPTS, bpy_pythons, needs_worker, run_bpy
from rolling_ball import write_rolling_ball

pytestmark = [
    pytest.mark.bpy,
    pytest.mark.faults,
    pytest.mark.skipif(sys.platform == "win32", reason="processes are killed"),
]
every_blender = pytest.mark.parametrize("python", bpy_pythons())
SECONDS = 120.0


def until(holds: Callable[[], object]) -> None:
    """Waits for something that comes."""
    end = time.monotonic() + SECONDS
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def record_of(path: Path) -> dict:
    """What a job has said in its file."""
    return json.loads(path.read_text("utf-8"))


def killed_blender(python: str, script: str, *words: object, once: Callable[[], object]) -> None:
    """Starts a script in a Python with bpy, and kills it once something holds."""
    variables = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    variables["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(SCRIPTS)])
    with subprocess.Popen(
        [python, str(SCRIPTS / script), *map(str, words)], env=variables, stdout=subprocess.DEVNULL
    ) as blender:
        try:
            until(lambda: once() or blender.poll() is not None)
            assert blender.poll() is None, "it ended by itself"
        finally:
            blender.kill()


@every_blender
def test_a_bake_goes_on_and_is_picked_up(python: str, tmp_path: Path) -> None:
    needs_worker(python)
    from chona_model.formats.exr_structure import is_whole
    from chona_model.owner import process_start

    model, _ = write_rolling_ball(tmp_path, 1)
    out = tmp_path / "out"

    def frames() -> list[Path]:
        return sorted(out.glob("walk_*.exr"))

    killed_blender(python, "detached_bake.py", "start", sys.executable, model, tmp_path, once=lambda: len(frames()) > 1)
    worker = record_of(out / ".chona-bake-walk.json")["owner"]
    there = len(frames())
    until(lambda: len(frames()) > there + 2)
    assert process_start(worker["pid"]) == worker["started"], "it has outlived its Blender"

    answer = run_bpy(python, "detached_bake.py", "pick-up", tmp_path, 2)
    assert answer["seen"][0] == "Bake walk" and " of 400" in answer["seen"][1], answer
    assert (answer["status"], answer["result"]) == ("CANCELLED", ["CANCELLED"])
    assert there + 4 < answer["done"] < answer["total"] == 400
    assert answer["nothing left"] and answer["threads"] == 0 and answer["news"] == []
    until(lambda: process_start(worker["pid"]) != worker["started"])
    assert len(frames()) == answer["done"] and all(map(is_whole, frames()))
    assert {path.name for path in out.iterdir()} == {"walk.shot.npz", *(path.name for path in frames())}


def detached(*words: object) -> dict:
    """Starts a command that goes on by itself; what it says."""
    done = subprocess.run(
        [sys.executable, "-m", "chona_model", *map(str, words), "--detach", "--progress", "json"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def bake_words(model: Path, shot: Path, out: Path, *more: object) -> list[object]:
    return ["bake", "--model", model, "--shot", shot, "--out", out, "--preset", "draft", *more]


@every_blender
def test_ends_are_told_once(python: str, tmp_path: Path) -> None:
    """Finished, killed, failed; and a file that names a process which is another program's."""
    needs_worker(python)
    from cli_files import write_capture

    from chona_model.owner import process_start

    model, shot = write_rolling_ball(tmp_path, 400)
    folders = {name: tmp_path / name for name in ("finished", "killed", "failed", "run")}
    told = detached(*bake_words(model, shot, folders["finished"], "--frames", "1-2"))
    until(lambda: process_start(told["pid"]) is None)
    told = detached(*bake_words(model, shot, folders["killed"]))
    until(lambda: len(list(folders["killed"].glob("*.exr"))) > 1)
    os.kill(told["pid"], signal.SIGKILL)
    until(lambda: process_start(told["pid"]) is None)
    told = detached(*bake_words(model, shot, folders["failed"], "--frames", "900"))
    until(lambda: process_start(told["pid"]) is None)
    told = detached("train", "--data", write_capture(tmp_path / "capture"), "--out", folders["run"], "--steps", 10**6)
    until(lambda: record_of(Path(told["file"]))["start"])
    os.kill(told["pid"], signal.SIGKILL)
    until(lambda: process_start(told["pid"]) is None)
    with subprocess.Popen(["sleep", "600"]) as stranger:
        reused = folders["killed"] / ".chona-bake-walk.json"
        content = record_of(reused)
        reused.write_text(json.dumps({**content, "owner": {**content["owner"], "pid": stranger.pid}}), "utf-8")
        (folders["failed"] / ".chona-bake-other.json").write_text('{"version": 1, "owner"', "utf-8")
        places = [
            *(("walk", str(folders[name])) for name in ("finished", "finished", "killed", "failed")),
            ("other", str(folders["failed"])),
            ("", str(folders["run"])),
        ]
        answer = run_bpy(python, "detached_ends.py", json.dumps(places))
        assert stranger.poll() is None, "a process that was never ours"
        stranger.kill()

    finished, again, killed, failed, damaged, run = answer["told"]
    assert all(each["result"] == ["FINISHED"] for each in answer["told"]) and not answer["nowhere"]
    assert len(finished["news"]) == 1 and finished["news"][0].startswith("Bake walk has finished at ")
    assert finished["news"][0].endswith(f"2 frames written in {folders['finished']}") and finished["dismiss"]
    assert (again["news"], again["error"], again["dismiss"]) == ([], "", False)
    done = content["progress"]["done"]
    assert killed["error"].startswith("Bake walk ended without Blender: it was killed, or the computer went down")
    assert killed["error"].endswith(f"{done} of 400 frames are there: press Bake to go on")
    assert failed["error"].startswith("Bake walk failed at ") and "900" in failed["error"]
    assert (damaged["news"], damaged["error"]) == ([], "") and damaged["left"] == [".chona-bake-other.json"]
    assert run["rows"][0][0] == "FAILED" and "with Resume it goes on" in run["rows"][0][1]
    assert [each["left"] for each in (finished, killed, run)] == [[], [], []]

"""Bakes and trainings that go on when Blender is killed: the next one shows, cancels, and tells their ends."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from operation_helpers import ROOT, SCRIPTS, bpy_pythons, needs_worker, run_bpy

pytestmark = [
    pytest.mark.bpy,
    pytest.mark.faults,
    pytest.mark.skipif(sys.platform == "win32", reason="processes are killed"),
]
every_blender = pytest.mark.parametrize("python", bpy_pythons())
SECONDS = 240.0


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
    from rolling_ball import write_rolling_ball

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


@every_blender
def test_a_training_goes_on_and_is_picked_up(python: str, tmp_path: Path) -> None:
    """Its row in the list is found again; paused there, it goes on to its end in the same list."""
    needs_worker(python)
    from cli_files import write_capture

    run = tmp_path / "run"
    small = ROOT / "tests" / "model" / "train" / "tiny_runs.py"
    capture = write_capture(tmp_path / "capture")

    def steps() -> int:
        log = run / "log.jsonl"
        return len(log.read_text("utf-8").splitlines()) if log.is_file() else 0

    words = (sys.executable, capture, tmp_path, small)
    killed_blender(python, "detached_training.py", "start", *words, once=lambda: steps() > 1)
    there = steps()
    until(lambda: steps() > there + 2)
    answer = run_bpy(python, "detached_training.py", "pick-up", *words)
    assert answer["opened"] == [["run", "PAUSED"]] and answer["meanwhile"] == [["run", "RUNNING"]]
    assert answer["closed"] == ["RUNNING", True], "another file was opened, and it went on"
    assert answer["title"] == "Train run" and answer["text"].startswith("step ")
    assert answer["result"] == ["FINISHED"] and answer["paused"] == [["run", "PAUSED", True]]
    assert not list(run.glob(".chona-*")) and not (run / "stop").exists()
    assert (run / "checkpoint.safetensors").is_file() and (run / "model.safetensors").is_file()


def job_process(path: Path, *events: dict) -> subprocess.Popen[bytes]:
    """A process that tells of a job; it has told all of these events, or ended."""
    path.parent.mkdir(exist_ok=True)
    program = [sys.executable, str(Path(__file__).with_name("job_process.py")), str(path)]
    with path.with_suffix(".log").open("ab") as log:
        process = subprocess.Popen([*program, *map(json.dumps, events)], stderr=log, cwd=ROOT,
                                   env=os.environ | {"PYTHONPATH": str(ROOT)})  # fmt: skip
    kinds = {"start", "progress", "end"}
    until(lambda: process.poll() is not None or (
        path.is_file() and sum(record_of(path)[kind] is not None for kind in kinds) == len(events)
    ))  # fmt: skip
    return process


START = {"event": "start", "job": "bake", "total": 50}
PROGRESS = {"event": "progress", "job": "bake", "done": 12, "total": 50, "seconds": 3.0, "eta": 9.0}


@every_blender
def test_ends_are_told_once(python: str, tmp_path: Path) -> None:
    """Finished, killed, failed; and a file that names a process which is another program's."""
    end = {"event": "result", "job": "bake", "written": 49, "skipped": 1}
    failure = {"event": "error", "job": "bake", "code": 2, "message": "the disk is full"}
    folders = {name: tmp_path / name for name in ("finished", "killed", "failed", "run")}
    files = {name: folder / ".chona-bake-walk.json" for name, folder in folders.items()}
    files["run"] = folders["run"] / ".chona-train.json"
    assert job_process(files["finished"], START, PROGRESS, end).wait(SECONDS) == 0
    assert job_process(files["failed"], START, failure).wait(SECONDS) == 1
    for name, events in (("killed", [START, PROGRESS]), ("run", [{**START, "job": "train"}])):
        with job_process(files[name], *events) as process:
            process.kill()
    (folders["failed"] / ".chona-bake-other.json").write_text('{"version": 1, "owner"', "utf-8")
    foreign = record_of(files["finished"])
    foreign["owner"]["host"] = "elsewhere"
    (folders["failed"] / ".chona-bake-foreign.json").write_text(json.dumps(foreign), "utf-8")
    with subprocess.Popen(["sleep", "600"]) as stranger:
        content = record_of(files["killed"])
        files["killed"].write_text(json.dumps({**content, "owner": {**content["owner"], "pid": stranger.pid}}), "utf-8")
        places = [
            *(("walk", str(folders[name])) for name in ("finished", "finished", "killed", "failed")),
            *((name, str(folders["failed"])) for name in ("other", "foreign")),
            ("", str(folders["run"])),
        ]
        answer = run_bpy(python, "detached_ends.py", json.dumps(places))
        assert stranger.poll() is None, "a process that was never ours"
        stranger.kill()

    finished, again, killed, failed, damaged, elsewhere, run = answer["told"]
    assert all(each["result"] == ["FINISHED"] for each in answer["told"]) and not answer["nowhere"]
    assert len(finished["news"]) == 1 and finished["news"][0].startswith("Bake walk has finished at ")
    assert finished["news"][0].endswith(f"49 frames written, 1 left as they were in {folders['finished']}")
    assert finished["dismiss"] and (again["news"], again["error"], again["dismiss"]) == ([], "", False)
    assert killed["error"].startswith(
        "Bake walk ended without Blender: the worker was killed, or the computer went down"
    )
    assert killed["error"].endswith("12 of 50 frames were done: press Bake to go on with the rest")
    assert failed["error"].startswith("Bake walk failed at ") and failed["error"].endswith(": the disk is full")
    assert all((each["news"], each["error"]) == ([], "") for each in (damaged, elsewhere))
    assert damaged["left"] == elsewhere["left"] == [".chona-bake-foreign.json", ".chona-bake-other.json"]
    assert run["rows"][0][0] == "FAILED" and "with Resume it goes on" in run["rows"][0][1]
    assert [each["left"] for each in (finished, killed, run)] == [[], [], []]

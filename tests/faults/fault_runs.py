"""Trainings and bakes in processes of their own, to be killed, starved and stopped."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

TINY_RUNS = Path(__file__).parents[1] / "model" / "train" / "tiny_runs.py"
ROOT = Path(__file__).parents[2]
SECONDS = 300
TOUCHES = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "shutil.rmtree"}
"""Audit events before which a program may end itself: in those moments something half done could be taken for whole,
and a random moment hardly ever meets one."""


def train_words(capture: Path, run: Path, steps: int, *more: str) -> list[str]:
    """A training with small trainers; a checkpoint every tenth of a second."""
    return [
        str(TINY_RUNS), "train", "--data", str(capture), "--out", str(run), "--steps", str(steps), "--progress", "json",
        *more,
    ]  # fmt: skip


def bake_words(model: Path, shot: Path, out: Path, *more: str) -> list[str]:
    """A bake of a shot."""
    return [
        "-m", "chona_model", "bake", "--model", str(model), "--shot", str(shot), "--out", str(out), "--preset", "draft",
        "--progress", "json", *more,
    ]  # fmt: skip


def environment(**more: str) -> dict[str, str]:
    """This process's, with these sources."""
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def start(words: list[str], **more: Any) -> subprocess.Popen[str]:
    """Starts a program."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(
        [sys.executable, *words], text=True, env=environment(**more.pop("variables", {})), **{**pipes, **more}
    )


def run(words: list[str], **more: Any) -> subprocess.CompletedProcess[str]:
    """Runs a program to its end, whatever that is; its standard input stays open until then."""
    reader, writer = os.pipe()
    with start(words, stdin=reader, **more) as process:
        try:
            output, errors = process.communicate(timeout=SECONDS)
        finally:
            process.kill()
            os.close(reader)
            os.close(writer)
    return subprocess.CompletedProcess(words, process.returncode, output, errors)


def finish(words: list[str]) -> dict[str, Any]:
    """Runs a program that must succeed; its last event."""
    done = run(words)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def read_until(process: subprocess.Popen[str], *events: str) -> dict[str, Any]:
    """Reads what a program says up to one of these events; the event."""
    assert process.stdout is not None and process.stderr is not None
    for line in process.stdout:
        content = json.loads(line)
        if content["event"] in events:
            return content
    raise AssertionError(f"the program ended: {process.stderr.read()}")


def tensors_of(path: Path) -> str:
    """Digest of a model file's tensors; its header holds the seconds, which differ."""
    content = path.read_bytes()
    return hashlib.sha256(content[8 + int.from_bytes(content[:8], "little") :]).hexdigest()


def names_in(folder: Path) -> set[str]:
    """Everything in a folder, hidden files too."""
    return {path.name for path in folder.iterdir()}


def end_before(touch: int, folder: Path) -> None:
    """Has this process killed, by itself, before the n-th time from now that it touches a file of a folder."""
    left, within = touch, os.path.realpath(folder) + os.sep

    def count(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal left
        if event not in TOUCHES or not isinstance(arguments[0], str | Path):
            return
        if event == "open" and not (arguments[2] & (os.O_WRONLY | os.O_RDWR)):
            return
        if os.path.realpath(arguments[0]).startswith(within):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(count)

"""Trainings and bakes in processes of their own, to be killed, starved and stopped.

Run as a program it is ``chona`` with small trainers that is killed, by itself and with SIGKILL, right before the n-th
time that it touches a file of a folder: ``python fault_runs.py N FOLDER train --data …``.  Those are the moments in
which something half done could be taken for whole; a random moment hardly ever meets one.
"""

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
"""Audit events before which the program may end itself."""


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
    return subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment(**more.pop("variables", {})), **more,
    )  # fmt: skip


def run(words: list[str], **more: Any) -> subprocess.CompletedProcess[str]:
    """Runs a program to its end, whatever that is."""
    with start(words, **more) as process:
        try:
            output, errors = process.communicate(timeout=SECONDS)
        finally:
            process.kill()
    return subprocess.CompletedProcess(words, process.returncode, output, errors)


def finish(words: list[str]) -> dict[str, Any]:
    """Runs a program that must succeed; its last event."""
    done = run(words)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def failed(done: subprocess.CompletedProcess[str], *said: str) -> str:
    """Of a program that must have failed with one line that says all of ``said``; that line."""
    assert done.returncode == 1, (done.returncode, done.stderr)
    lines = done.stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("chona: "), done.stderr
    missing = [words for words in said if words not in lines[0]]
    assert not missing, (missing, lines[0])
    return lines[0]


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


def main(words: list[str]) -> int:
    """The program that ends itself before its n-th touch of a file in a folder."""
    left, folder = int(words[0]), os.path.realpath(words[1])

    def count(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal left
        if event not in TOUCHES or not isinstance(arguments[0], str | Path):
            return
        if event == "open" and arguments[1] in (None, "r", "rb") and not (arguments[2] & (os.O_WRONLY | os.O_RDWR)):
            return
        if os.path.realpath(arguments[0]).startswith(folder + os.sep):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    for path in (TINY_RUNS.parent, TINY_RUNS.parents[1]):
        sys.path.insert(0, str(path))
    import tiny_runs

    import chona_model.train.run as loop
    from chona_model.cli import main as chona

    loop.make_trainer, loop.LOG_EVERY, loop.CHECKPOINT_SECONDS = tiny_runs.make_small, 1, 0.1
    sys.addaudithook(count)
    return chona(words[2:])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

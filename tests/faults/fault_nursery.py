"""Processes by the hundred: one that has loaded torch and all kernels, and forks a child for every training and bake.

A child is a process of its own, which ends by itself or is killed; only the seconds of its start are saved.  Run as a
program it reads commands, one JSON line each, and answers with what became of them.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
import traceback
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "model" / "train"))

from fault_runs import SECONDS, end_before, environment

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_THREADING_LAYER": "workqueue",
}
"""Threads do not come along into a child."""


class Child:
    """A process that does one command of ``chona``."""

    def __init__(self, nursery: Nursery, pid: int, told: Path) -> None:
        self._nursery, self.pid, self._told = nursery, pid, told

    def events(self) -> list[dict[str, Any]]:
        """What it has said so far."""
        lines = self._told.read_text("utf-8").splitlines(keepends=True)
        return [json.loads(line) for line in lines if line.startswith("{") and line.endswith("\n")]

    def wait_for(self, event: str) -> None:
        """Waits until it has said so, or has ended."""
        until = time.monotonic() + SECONDS
        while not any(told["event"] in (event, "error") for told in self.events()):
            assert time.monotonic() < until, self._told.read_text("utf-8")
            time.sleep(0.01)

    def kill(self) -> int:
        """Kills it if it runs still; its exit code, -9 if it was killed."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        return self.wait()

    def wait(self) -> int:
        """Its exit code."""
        return int(self._nursery.ask(wait=self.pid)["code"])

    def finish(self) -> dict[str, Any]:
        """Waits for its success; its last event."""
        code = self.wait()
        assert code == 0, self._told.read_text("utf-8")
        return self.events()[-1]

    def fail(self, *said: str) -> str:
        """Waits for its failure with one line that says all of ``said``; that line."""
        code, text = self.wait(), self._told.read_text("utf-8")
        lines = [line for line in text.splitlines() if not line.startswith("{")]
        assert (code, len(lines)) == (1, 1) and lines[0].startswith("chona: "), (code, text)
        missing = [words for words in said if words not in lines[0]]
        assert not missing, (missing, lines[0])
        assert self.events()[-1] == {**self.events()[-1], "event": "error", "code": 1}
        return lines[0]


class Nursery:
    """The process that has everything loaded.

    Args:
        folder: for what its children say.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._count = folder, 0
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=environment(**ONE_THREAD),
        )  # fmt: skip

    def warm(self, *commands: list[str]) -> None:
        """Does commands itself, which loads what its children will need."""
        assert self.ask(warm=commands)["codes"] == [0] * len(commands)

    def ask(self, **words: Any) -> dict[str, Any]:
        """A command, and what came of it."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(words) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def start(
        self, words: list[str], killed_before: tuple[int, Path] | None = None, limits: dict[str, int] | None = None,
        clock_jumps: bool = False,
    ) -> Child:  # fmt: skip
        """Starts a child.

        Args:
            killed_before: the how manieth touch of a file in which folder it does not live to see.
            limits: what the system grants it, by names of the module ``resource``; of memory, more than it has now.
            clock_jumps: whether every look at the clock on the wall finds it in another year.
        """
        self._count += 1
        told = self._folder / f"told{self._count}"
        told.touch()
        touch, folder = killed_before or (0, Path())
        answer = self.ask(words=words, told=str(told), touch=touch, folder=str(folder), limits=limits or {},
                          jumps=clock_jumps)  # fmt: skip
        return Child(self, int(answer["pid"]), told)

    def close(self) -> None:
        """Ends the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(SECONDS)


def live(command: dict[str, Any]) -> None:
    """What a child does."""
    from chona_model.cli import main as chona

    handle = os.open(command["told"], os.O_WRONLY)
    for number in (1, 2):
        os.dup2(handle, number)
    code = 1
    try:
        for name, most in command["limits"].items():
            now = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
            resource.setrlimit(getattr(resource, name), (most + now * (name == "RLIMIT_AS"),) * 2)
        if command["jumps"]:
            clock, chance = time.time, random.Random(1)
            time.time = lambda: clock() + chance.uniform(-4e7, 4e7)
        if command["touch"]:
            end_before(command["touch"], Path(command["folder"]))
        code = chona(command["words"])
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def main() -> None:
    """Answers commands until there are no more."""
    import tiny_runs

    import chona_model.train.run as loop
    from chona_model.cli import main as chona

    large = loop.make_trainer
    loop.make_trainer, loop.LOG_EVERY, loop.CHECKPOINT_SECONDS = tiny_runs.make_small, 1, 0.05
    for line in sys.stdin:
        command = json.loads(line)
        if "warm" in command:
            with contextlib.redirect_stdout(sys.stderr):
                answer: dict[str, Any] = {"codes": [chona(words) for words in command["warm"]]}
        elif "wait" in command:
            answer = {"code": os.waitstatus_to_exitcode(os.waitpid(command["wait"], 0)[1])}
        else:
            pid = os.fork()
            if pid == 0:
                if "RLIMIT_AS" in command["limits"]:
                    loop.make_trainer = large  # small ones do with what the heap has left
                live(command)
            answer = {"pid": pid}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()

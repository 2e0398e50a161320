"""Several processes that train one model, started by torchrun: they learn what one process learns, and go on after a
kill as if nothing had happened."""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

sys.path.insert(0, str(Path(__file__).parents[1] / "model"))
sys.path.insert(0, str(Path(__file__).parents[1] / "model" / "train"))

import tiny_runs
from cli_files import SEQUENCE, write_capture
from numba import get_num_threads, set_num_threads

from chona_model.arguments import UsageError
from chona_model.cli import main
from chona_model.command_parts import _own_card
from chona_model.kernels.threads import share_out
from chona_model.train.checkpoint import save_checkpoint, saved_by

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds processes in /proc"),
]

ROOT = Path(__file__).parents[2]
SMALL = Path(tiny_runs.__file__)
STEPS = {"fast": 60, "paper": 8}
"""The fast preset's hold a culling and new grids after 48 steps, skinning, and finer steps."""
WAIT = 300
"""Seconds after which a launch counts as stuck."""

CLOSE = 1e-4
"""Relative distance of any tensor of two models that differ by the order of sums alone."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captures ``one`` and ``two`` of different people and objects, so that their codes are exchanged."""
    folder = tmp_path_factory.mktemp("together")
    write_capture(folder / "one")
    write_capture(folder / "two")
    path = folder / "two" / "capture.json"
    path.write_text(path.read_text("utf-8").replace("Sub01", "Sub02").replace("box01", "box02"), "utf-8")
    (folder / "two" / "sequences" / SEQUENCE).rename(folder / "two" / "sequences" / "Date01_Sub02_box02")
    return folder


def words(folder: Path, out: str, preset: str, *more: str) -> list[str]:
    """Of ``chona train`` on both captures."""
    return ["train", "--data", str(folder / "one"), "--data", str(folder / "two"), "--out", str(folder / out),
            "--preset", preset, "--steps", str(STEPS[preset]), "--progress", "json", *more]  # fmt: skip


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def launcher(*options: str, processes: int = 2, program: Path = SMALL, port: int | None = None) -> list[str]:
    """torchrun on this computer alone."""
    return [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", str(processes), "--master-addr",
            "127.0.0.1", "--master-port", str(port or free_port()), *options, str(program)]  # fmt: skip


def variables(**more: str) -> dict[str, str]:
    """One thread a process, however many there are."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PYTHONPATH": path, "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **more}


def finish(line: list[str], code: int = 0, **more: str) -> tuple[str, str]:
    """What a launch that ends with ``code`` has written on stdout and stderr."""
    with started(line, **more) as process:
        output, errors = process.communicate(timeout=WAIT)
    assert process.returncode == code, errors
    return output, errors


@contextmanager
def started(line: list[str], **more: str) -> Iterator[subprocess.Popen[str]]:
    """A launch that leaves no process behind."""
    process = subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=variables(**more), start_new_session=True
    )
    try:
        yield process
    finally:
        children = workers(process.pid).values()
        process.kill()
        for child in children:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        process.communicate()


def workers(launcher: int) -> dict[int, int]:
    """Process ids by rank of what a launcher has started and what still runs."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            values = dict(item.partition("=")[::2] for item in (path / "environ").read_text().split("\0"))
        except OSError:  # it has ended, or is somebody else's
            continue
        if parent == launcher and "RANK" in values:
            found[int(values["RANK"])] = int(path.name)
    return found


def wait_until(true: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + WAIT
    while not true():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.005)


def steps_of(folder: Path, out: str) -> list[int]:
    path = folder / out / "log.jsonl"
    return [json.loads(line)["step"] for line in path.read_text("utf-8").splitlines()] if path.exists() else []


def tensors_of(folder: Path, out: str) -> str:
    """Digest of the model file's tensors; its header holds the seconds, which differ."""
    content = (folder / out / "model.safetensors").read_bytes()
    return hashlib.sha256(content[8 + int.from_bytes(content[:8], "little") :]).hexdigest()


def messages(errors: str) -> list[str]:
    """What chona itself says on stderr, between all that torchrun says."""
    return [line for line in errors.splitlines() if line.startswith("chona: ")]


@pytest.fixture(scope="module")
def both(folder: Path) -> Callable[[str], str]:
    """Trains with two processes, once a preset, and names the run."""

    def run(preset: str) -> str:
        out = f"both_{preset}"
        if not (folder / out).exists():
            output, _ = finish([*launcher(), *words(folder, out, preset)])
            events = [json.loads(line)["event"] for line in output.splitlines()]
            assert (events.count("start"), events.count("result")) == (1, 1), "one process alone reports"
            assert steps_of(folder, out) == list(range(1, STEPS[preset] + 1)), "every step once"
        return out

    return run


@pytest.fixture(scope="module")
def alone(folder: Path) -> Callable[[str], str]:
    """Trains with one process and without torchrun, once a preset, and names the run."""

    def run(preset: str) -> str:
        out = f"alone_{preset}"
        if not (folder / out).exists():
            finish([sys.executable, str(SMALL), *words(folder, out, preset)])
        return out

    return run


def assert_close(folder: Path, first: str, second: str) -> None:
    one, two = (load_file(folder / out / "model.safetensors") for out in (first, second))
    assert one.keys() == two.keys()
    learned = {name for name, value in one.items() if value.is_floating_point()}
    far = {name: float((two[name] - one[name]).norm() / one[name].norm().clamp(min=1e-6)) for name in learned}
    assert max(far.values()) < CLOSE, max(far.items(), key=lambda item: item[1])
    assert all(torch.equal(one[name], two[name]) for name in one.keys() - learned)


@pytest.mark.parametrize("preset", ["fast", pytest.param("paper", marks=pytest.mark.slow)])
def test_two_processes_learn_what_one_learns(folder: Path, alone, both, preset: str) -> None:
    assert_close(folder, alone(preset), both(preset))


@pytest.mark.slow
def test_two_processes_add_what_one_adds(folder: Path, alone) -> None:
    """With the settings of users, which ``chona add`` always takes."""
    line = ["add", "--model", str(folder / alone("fast") / "model.safetensors"), "--data", str(folder / "two"),
            "--identity", "Sub02=Ann", "box02=cup", "--steps", "6"]  # fmt: skip
    finish([sys.executable, str(SMALL), *line, "--out", str(folder / "added_alone")])
    finish([*launcher(), *line, "--out", str(folder / "added_both")])
    assert_close(folder, "added_alone", "added_both")


@pytest.mark.slow
def test_the_time_is_over_for_all_at_once(folder: Path) -> None:
    """Each process has a clock of its own; one that went on alone would wait for the others in vain."""
    line = [word for word in words(folder, "timed", "fast") if word not in {"--steps", str(STEPS["fast"])}]
    output, _ = finish([*launcher(), *line, "--minutes", "0.03"])
    last = json.loads(output.splitlines()[-1])
    assert last["event"] == "result"
    assert last["steps"] == steps_of(folder, "timed")[-1]


@pytest.mark.slow
def test_a_single_process_of_torchrun_is_alone(folder: Path, alone) -> None:
    finish([*launcher(processes=1), *words(folder, "single", "fast")])
    assert tensors_of(folder, "single") == tensors_of(folder, alone("fast"))


@pytest.mark.parametrize("preset", ["fast", pytest.param("paper", marks=pytest.mark.slow)])
@pytest.mark.parametrize("rank", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_killed_process_is_started_again(folder: Path, both, often, preset: str, rank: int) -> None:
    draw = random.Random(rank)
    for number in range(often(1, 25)):
        out, at = f"killed_{preset}_{rank}_{number}", draw.randrange(1, STEPS[preset] * 3 // 4)
        with started([*launcher("--max-restarts", "1"), *words(folder, out, preset)]) as process:
            wait_until(lambda out=out, at=at: len(steps_of(folder, out)) >= at, process)
            time.sleep(draw.random() * 0.05)
            os.kill(workers(process.pid)[rank], signal.SIGKILL)
            _, errors = process.communicate(timeout=WAIT)
        assert process.returncode == 0, errors
        assert len(messages(errors)) <= 1, errors
        assert tensors_of(folder, out) == tensors_of(folder, both(preset)), at
        assert steps_of(folder, out) == list(range(1, STEPS[preset] + 1)), "every step once"


@pytest.mark.slow
def test_two_computers_go_on_together(folder: Path, both) -> None:
    """Two launchers, as on two computers: a process of the second is killed, and both launchers start theirs again."""
    out, port = "computers", free_port()
    lines = [
        [*launcher("--max-restarts", "1", "--nnodes", "2", "--node-rank", str(number), processes=1, port=port),
         *words(folder, out, "fast")]
        for number in range(2)
    ]  # fmt: skip
    with started(lines[0]) as first, started(lines[1]) as second:
        wait_until(lambda: len(steps_of(folder, out)) >= 20, first)
        os.kill(workers(second.pid)[1], signal.SIGKILL)
        for process in (first, second):
            _, errors = process.communicate(timeout=WAIT)
            assert process.returncode == 0, errors
    assert tensors_of(folder, out) == tensors_of(folder, both("fast"))


@pytest.mark.slow
def test_a_failure_in_one_process_is_told_once(folder: Path) -> None:
    program = Path(__file__).with_name("together_program.py")
    output, errors = finish([*launcher(program=program), *words(folder, "failed", "fast")], 1, CHONA_TEST_FAIL_AT="12")
    assert messages(errors) == ["chona: OSError: the card has fallen out (--debug shows where)"]
    events = [json.loads(line) for line in output.splitlines()]
    assert [event["event"] for event in events if event["event"] in {"error", "result", "cancelled"}] == ["error"]
    assert not (folder / "failed" / "model.safetensors").exists()


@pytest.mark.slow
def test_a_lost_process_is_told_once_with_what_is_kept(folder: Path) -> None:
    out = "lost"
    with started([*launcher(), *words(folder, out, "fast")]) as process:
        wait_until((folder / out / "checkpoint.safetensors").exists, process)
        os.kill(workers(process.pid)[1], signal.SIGKILL)
        _, errors = process.communicate(timeout=WAIT)
    assert process.returncode == 1
    (message,) = messages(errors)
    assert "another process of this training is gone" in message
    assert "is kept, --resume --steps" in message


@pytest.mark.slow
def test_data_that_cannot_be_read_are_told_once(folder: Path, tmp_path: Path) -> None:
    line = ["train", "--data", str(tmp_path), "--out", str(tmp_path / "run")]
    _, errors = finish([*launcher(), *line], 1)
    (message,) = messages(errors)
    assert str(tmp_path) in message


@pytest.mark.slow
@pytest.mark.parametrize("way", ["file", "signal"])
def test_a_stopped_training_is_continued_by_both(folder: Path, both, way: str) -> None:
    """The user's wish is no failure, after which the launcher would start anew."""
    out = f"stopped_{way}"
    with started([*launcher("--max-restarts", "3"), *words(folder, out, "fast")]) as process:
        wait_until(lambda: len(steps_of(folder, out)) >= 5, process)
        if way == "file":
            (folder / out / "stop").touch()
        else:
            process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=WAIT)
    assert process.returncode == (0 if way == "file" else 1), errors
    assert [json.loads(line)["event"] for line in output.splitlines()][-1] == "cancelled"
    assert len(steps_of(folder, out)) < STEPS["fast"]
    assert (folder / out / "model.safetensors").exists()
    finish([*launcher(), *words(folder, out, "fast", "--resume")])
    assert tensors_of(folder, out) == tensors_of(folder, both("fast"))


def test_a_checkpoint_of_another_job_is_not_continued_by_the_launcher(tmp_path: Path) -> None:
    assert saved_by(tmp_path) == ""
    for position, job in (({"step": 1, "seconds": 0.5, "job": "monday"}, "monday"), ({"step": 1, "seconds": 0.5}, "")):
        save_checkpoint(tmp_path, {"value": torch.zeros(1)}, position, {})
        assert saved_by(tmp_path) == job


def test_cores_are_shared_out(monkeypatch) -> None:
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    cores = get_num_threads()
    try:
        assert share_out(cores) == get_num_threads() == 1
        assert share_out(7) == 1
        set_num_threads(cores)
        monkeypatch.setenv("NUMBA_NUM_THREADS", str(cores))
        assert share_out(cores) == cores, "the user's own number"
    finally:
        set_num_threads(cores)


def test_other_commands_do_not_work_together(monkeypatch, capsys, tmp_path: Path) -> None:
    told = {"TORCHELASTIC_RUN_ID": "job", "RANK": "0", "WORLD_SIZE": "3", "LOCAL_RANK": "0", "LOCAL_WORLD_SIZE": "3",
            "TORCHELASTIC_RESTART_COUNT": "0", "TORCHELASTIC_MAX_RESTARTS": "0"}  # fmt: skip
    for name, value in told.items():
        monkeypatch.setenv(name, value)
    assert main(["info", str(tmp_path)]) == 2
    assert "torchrun has started 3 processes of 'info'" in capsys.readouterr().err
    monkeypatch.setenv("RANK", "1")
    assert main(["info", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "", "one process tells it"
    with pytest.raises(UsageError, match="3 processes on a computer with 2 graphics cards; give --nproc-per-node 2"):
        _own_card(2)

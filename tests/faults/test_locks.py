"""Two of a kind in one folder: the second is refused and says who was first; a lock that nobody holds is taken over."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from fault_runs import environment, names_in
from fault_scene import FRAMES, Scene

from chona_model.formats.atomic import clear_leftovers, write_bytes
from chona_model.formats.folder_lock import (
    STALE_SECONDS,
    FolderBusyError,
    FolderLostError,
    Holder,
    lock_folder,
)
from chona_model.owner import process_start, this_process

pytestmark = [pytest.mark.faults, pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")]

HOLD = """
import sys, time
from pathlib import Path
from chona_model.formats.folder_lock import lock_folder
frames = [int(word) for word in sys.argv[2].split(",") if word]
with lock_folder(Path(sys.argv[1]), "the shot walk", frames or None):
    print("held", flush=True)
    time.sleep(60)
"""


def hold(folder: Path, frames: str = "") -> subprocess.Popen[str]:
    """A process that holds a lock."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder), frames], stdout=subprocess.PIPE, text=True, env=environment()
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def left(folder: Path, holder: Holder, age: float = 0.0) -> Path:
    """The file of a lock that nobody has locked."""
    path = folder / ".chona-0123456789abcdef.lock"
    path.write_text(holder.text(), "utf-8")
    os.utime(path, (time.time() - age,) * 2)
    return path


def me(**changes: object) -> Holder:
    return Holder(replace(this_process(), **changes), "2026-01-02 03:04:05", "the shot walk", None)


def test_a_second_bake_is_refused_and_a_third_is_not(scene: Scene, tmp_path: Path) -> None:
    """Frames that the first does not make are free; its own are again when it was killed."""
    first = scene.nursery.start(scene.bake(tmp_path, "--frames", "0-20"))
    first.wait_for("start")
    os.kill(first.pid, signal.SIGSTOP)
    words = scene.nursery.start(scene.bake(tmp_path)).fail("the shot walk is being written into", str(tmp_path))
    assert f"by process {first.pid} on {os.uname().nodename} since 20" in words
    assert "21 of the same frames, the first is 0" in words and "wait until it has ended" in words
    assert scene.nursery.start(scene.bake(tmp_path, "--frames", "21-22")).finish()["written"] == 2
    first.kill()
    assert scene.nursery.start(scene.bake(tmp_path)).finish()["skipped"] >= 2
    assert len(names_in(tmp_path)) == FRAMES


def test_a_second_training_is_refused_and_harms_nothing(scene: Scene, tmp_path: Path) -> None:
    first = scene.nursery.start(scene.train(tmp_path))
    first.wait_for("progress")
    os.kill(first.pid, signal.SIGSTOP)
    before = (tmp_path / "log.jsonl").read_bytes()
    scene.nursery.start(scene.train(tmp_path)).fail("training is being written into", f"process {first.pid}")
    assert (tmp_path / "log.jsonl").read_bytes() == before
    os.kill(first.pid, signal.SIGCONT)
    first.finish()
    assert names_in(tmp_path) == {"model.safetensors", "checkpoint.safetensors", "log.jsonl"}


def test_what_does_not_meet_is_not_refused(tmp_path: Path) -> None:
    with hold(tmp_path, "1,2,3") as other:
        with pytest.raises(FolderBusyError, match=r"1 of the same frames, the first is 3"):
            lock_folder(tmp_path, "the shot walk", [3, 4]).__enter__()
        with pytest.raises(FolderBusyError, match=f"process {other.pid}"):
            lock_folder(tmp_path, "the shot walk").__enter__()
        with lock_folder(tmp_path, "the shot walk", [4]), lock_folder(tmp_path, "training"):
            assert len(names_in(tmp_path)) == 3
        other.kill()
    with lock_folder(tmp_path, "the shot walk"):
        assert len(names_in(tmp_path)) == 1, "the dead one's is gone"
    assert names_in(tmp_path) == set()


def test_one_process_cannot_lock_twice(tmp_path: Path) -> None:
    with lock_folder(tmp_path, "training"), pytest.raises(FolderBusyError, match=f"process {os.getpid()}"):
        lock_folder(tmp_path, "training").__enter__()


def test_of_many_that_start_at_once_one_goes_on(tmp_path: Path, often) -> None:
    for number in range(often(1, 100)):
        folder = tmp_path / str(number)
        code = HOLD.replace("time.sleep(60)", "sys.stdin.read()")
        words = [sys.executable, "-c", code, str(folder), ""]
        crowd = [
            subprocess.Popen(
                words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                env=environment(),
            )
            for _ in range(6)
        ]  # fmt: skip
        while sum(each.poll() is None for each in crowd) > 1:
            time.sleep(0.02)
        told = [each.communicate()[0] for each in crowd]
        assert sorted(told) == [""] * 5 + ["held\n"] and names_in(folder) == set()


@pytest.mark.parametrize(
    ("changes", "age", "free"),
    [
        ({"pid": 2**22 + 1}, 0.0, True),  # no such process
        ({"started": "1"}, 0.0, True),  # another program has its number
        ({}, 0.0, True),  # this very process, whose lock the system says is gone
        ({"machine": "0" * 8, "host": "node7"}, 0.0, False),
        ({"machine": "0" * 8, "host": "node7"}, STALE_SECONDS - 30, False),
        ({"machine": "0" * 8, "host": "node7"}, STALE_SECONDS + 1, True),
    ],
)
def test_whose_lock_nobody_holds(tmp_path: Path, changes: dict, age: float, free: bool) -> None:
    path = left(tmp_path, me(**changes), age)
    if free:
        with lock_folder(tmp_path, "the shot walk"):
            assert not path.exists()
    else:
        with pytest.raises(FolderBusyError, match=r"on node7 since 2026-01-02 03:04:05.*known after 2 minutes"):
            lock_folder(tmp_path, "the shot walk").__enter__()
        assert path.exists()


def test_a_lock_that_was_never_finished(tmp_path: Path) -> None:
    (tmp_path / ".chona-00.lock").write_bytes(b'{"host": "no')
    with lock_folder(tmp_path, "training"):
        assert len(names_in(tmp_path)) == 1


def test_whoever_was_pushed_aside_writes_no_more(tmp_path: Path) -> None:
    with lock_folder(tmp_path / "out", "training") as held:
        held.check()
        held.path.unlink()
        with pytest.raises(FolderLostError, match="taken over by another process"):
            held.check()
        (tmp_path / "out").rmdir()
        with pytest.raises(FolderLostError, match="was removed while training was written into it"):
            held.check()


def test_a_process_is_told_from_another_of_its_number() -> None:
    with subprocess.Popen(["sleep", "60"]) as process:
        start = process_start(process.pid)
        assert start and start != process_start(os.getppid())
        other = replace(this_process(), pid=process.pid, started=start)
        assert other.is_alive() and not replace(other, started="1").is_alive()
        assert not replace(other, machine="0" * 8).is_alive(), "of another machine nothing is known"
        process.kill()
        process.wait()
        assert process_start(process.pid) is None and not other.is_alive()


def test_leftovers_of_the_dead_go_and_of_the_living_stay(tmp_path: Path) -> None:
    """Files and folders, of this machine and of others; what looks alike is nobody's business."""
    owner, now = this_process(), time.time()
    with subprocess.Popen(["true"]) as gone:
        gone.wait()
    marks = {
        "mine": f"{owner.machine}-{owner.pid}-{owner.started}", "dead": f"{owner.machine}-{gone.pid}-7",
        "again": f"{owner.machine}-{owner.pid}-7", "far": "00000000-1-7", "old": "00000000-2-7",
    }  # fmt: skip
    for name, mark in marks.items():
        write_bytes(tmp_path / f".{name}.{mark}-0123abcd.tmp.exr", b"x")
    (tmp_path / f".model.{marks['dead']}-0123abcd.tmp").mkdir()
    (tmp_path / f".model.{marks['dead']}-0123abcd.tmp" / "model.safetensors").touch()
    (tmp_path / ".mine.tmp.exr").touch()
    old = next(tmp_path.glob(".old*"))
    os.utime(old, (now - 90_000,) * 2)
    assert clear_leftovers(tmp_path, now) == 4
    assert sorted(name.split(".")[1] for name in names_in(tmp_path)) == ["far", "mine", "mine"]


def test_the_file_says_what_docs_say(tmp_path: Path) -> None:
    with lock_folder(tmp_path, "the shot walk", [2, 1]) as held:
        told = json.loads(held.path.read_text("utf-8"))
    assert told.keys() == {"host", "machine", "pid", "started", "since", "what", "frames", "shared"}
    assert (told["pid"], told["what"], told["frames"]) == (os.getpid(), "the shot walk", [1, 2])

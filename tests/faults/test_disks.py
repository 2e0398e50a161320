"""Disks that are full, read only or gone: one line that says so and what to do, and what was finished is kept."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fault_nursery import Child
from fault_runs import names_in, tensors_of
from fault_scene import FRAMES, Scene

from chona_model.formats.exr_structure import is_whole

pytestmark = [pytest.mark.faults, pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")]

Mount = Callable[[str], None]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[tuple[Path, Mount]]:
    """A small disk, and what changes its size."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or shutil.which("mount") is None or subprocess.run(command, check=False).returncode:
        pytest.skip("only root may make a small disk, and not everywhere")
    yield (
        folder,
        lambda options: (
            subprocess.run(["mount", "-o", f"remount,{options}", "tmpfs", str(folder)], check=True) and None
        ),
    )
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def wait_for_frames(child: Child, out: Path, count: int) -> None:
    """Waits until a bake has written so many."""
    until = time.monotonic() + 120
    while len(list(out.glob("walk*.exr"))) < count:
        assert time.monotonic() < until, child.events()
        time.sleep(0.002)


def test_a_full_disk_keeps_the_frames(scene: Scene, disk: tuple[Path, Mount], often) -> None:
    folder, remount = disk
    for number in range(often(1, 30)):
        out = folder / str(number)
        words = scene.nursery.start(scene.bake(out)).fail(
            "cannot write", "No space left on device; free some space there", "the same command goes on with the rest"
        )
        there = sorted(out.glob("walk*.exr"))
        assert 0 < len(there) < FRAMES and all(is_whole(path) for path in there)
        assert f"{len(there)} frames are there and whole, of {FRAMES}" in words
        assert names_in(out) == {path.name for path in there}
        remount("size=4m")
        told = scene.nursery.start(scene.bake(out)).finish()
        assert (told["skipped"], told["written"]) == (len(there), FRAMES - len(there))
        shutil.rmtree(out)
        remount("size=64k")


def test_a_full_disk_keeps_the_checkpoint(scene: Scene, disk: tuple[Path, Mount], often) -> None:
    folder, remount = disk
    for number in range(often(1, 10)):
        out = folder / str(number)
        remount("size=3m")
        words = scene.nursery.start(scene.train(out)).fail(
            "cannot write", "No space left on device", "the checkpoint of"
        )
        assert "--resume" in words and names_in(out) == {"checkpoint.safetensors", "log.jsonl"}
        remount("size=20m")
        scene.nursery.start(scene.train(out)).finish()
        assert tensors_of(out / "model.safetensors") == tensors_of(scene.model)
        shutil.rmtree(out)


def test_a_disk_that_is_full_from_the_start(scene: Scene, disk: tuple[Path, Mount]) -> None:
    folder, _ = disk
    with (folder / "filler").open("wb", buffering=0) as filler, contextlib.suppress(OSError):
        while True:
            filler.write(bytes(4096))
    scene.nursery.start(scene.bake(folder)).fail("cannot write", "No space left", "free some space there")
    scene.nursery.start(scene.train(folder)).fail("cannot write", "No space left")
    assert names_in(folder) == {"filler"}


def test_files_that_may_not_grow(scene: Scene, tmp_path: Path) -> None:
    """As where a user's share of the disk is used up."""
    limits = {"RLIMIT_FSIZE": 1 << 20}
    words = scene.nursery.start(scene.train(tmp_path / "run"), limits=limits).fail("File too large", "ulimit -f")
    assert "no checkpoint was written, and no model" in words
    assert names_in(tmp_path / "run") == {"log.jsonl"}
    small = {"RLIMIT_FSIZE": 3000}
    scene.nursery.start(scene.bake(tmp_path / "out"), limits=small).fail("walk_-0001.exr", "no frame is there yet")
    assert names_in(tmp_path / "out") == set()


def test_a_folder_that_is_taken_away(scene: Scene, tmp_path: Path, often) -> None:
    for number in range(often(1, 30)):
        out, away = tmp_path / f"out{number}", tmp_path / f"away{number}"
        child = scene.nursery.start(scene.bake(out))
        wait_for_frames(child, out, 2)
        out.rename(away)
        child.fail(f"the folder {out} was removed while the shot walk was written into it", "run the command again")
        assert not out.exists(), "it was made again, as if nothing had happened"
        assert all(is_whole(path) for path in away.glob("walk*.exr"))


def test_a_training_whose_folder_is_taken_away(scene: Scene, tmp_path: Path) -> None:
    out = tmp_path / "run"
    child = scene.nursery.start(scene.train(out))
    child.wait_for("progress")
    out.rename(tmp_path / "away")
    child.fail(f"the folder {out} was removed while training was written into it")
    assert not out.exists()


@pytest.fixture
def make_read_only(tmp_path: Path) -> Iterator[Callable[[Path], None]]:
    """Keeps everybody from writing into a folder, root too."""
    locked: list[Path] = []

    def lock(folder: Path) -> None:
        if os.geteuid():
            folder.chmod(0o555)
        elif shutil.which("chattr") is None or subprocess.run(["chattr", "+i", folder], check=False).returncode:
            pytest.skip("root may write everywhere on this disk")
        locked.append(folder)

    yield lock
    for folder in locked:
        subprocess.run(["chattr", "-i", folder], check=True) if not os.geteuid() else folder.chmod(0o755)


def test_a_folder_that_becomes_read_only(
    scene: Scene, tmp_path: Path, make_read_only: Callable[[Path], None]
) -> None:  # fmt: skip
    out = tmp_path / "out"
    child = scene.nursery.start(scene.bake(out))
    wait_for_frames(child, out, 2)
    make_read_only(out)
    child.fail("cannot write", "make the folder writable", "the same command goes on with the rest")
    assert all(is_whole(path) for path in out.glob("walk*.exr"))

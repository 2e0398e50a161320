"""Too little memory: one line that says so; and a bake that keeps to what it is allowed."""

from __future__ import annotations

import re
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fault_runs import bake_words, names_in, start
from fault_scene import Scene

from chona_model.formats.exr import read_frame
from chona_model.formats.shot import read_shot, write_shot

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(sys.platform != "linux", reason="memory is limited and asked for as Linux does"),
]


def enlarged(scene: Scene, folder: Path, factor: int) -> Path:
    """The first frame of the shot, so many times as wide and as high, and twice as close."""
    shot = read_shot(scene.shot)
    intrinsics = shot.intrinsics[:1].copy()
    intrinsics[:, :2, :2] *= 2 * factor
    intrinsics[:, :2, 2] *= factor
    actors = (
        replace(a, world_from_bone=a.world_from_bone[:1], world_from_object=a.world_from_object[:1])
        for a in shot.actors
    )
    path = folder / "large.shot.npz"
    write_shot(path, replace(
        shot, width=shot.width * factor, height=shot.height * factor, intrinsics=intrinsics, frames=shot.frames[:1],
        world_from_camera=shot.world_from_camera[:1], clip=shot.clip[:1], actors=tuple(actors),
    ))  # fmt: skip
    return path


def test_a_bake_without_memory_says_so(scene: Scene, tmp_path: Path, often) -> None:
    shot, out = enlarged(scene, tmp_path, 100), tmp_path / "out"
    for number in range(often(2, 20)):
        limits = {"RLIMIT_AS": (30 + 10 * number) << 20}
        child = scene.nursery.start(bake_words(scene.model, shot, out)[2:], limits=limits)
        child.fail("out of memory", "frames that are there are whole and kept", "--max-memory")
        assert names_in(out) == set()


def test_a_training_without_memory_says_so(scene: Scene, tmp_path: Path) -> None:
    child = scene.nursery.start(scene.train(tmp_path / "run"), limits={"RLIMIT_AS": 30 << 20})
    child.fail("out of memory", "--image-scale", "close other programs")


def baked_within(scene: Scene, shot: Path, out: Path, *more: str) -> tuple[int, int, str]:
    """Exit code and highest memory in bytes of a bake, and what it said on stderr."""
    highest = 0
    with (out.parent / f"{out.name}.txt").open("w+") as said:
        with start(bake_words(scene.model, shot, out, *more), stdout=said, stderr=said) as process:
            # What the system counts of a child that has ended includes what it was forked from, here all of pytest.
            while process.poll() is None:
                status = Path(f"/proc/{process.pid}/status").read_text("utf-8")
                found = re.search(r"^VmHWM:\s+(\d+) kB$", status, re.MULTILINE)
                highest = max(highest, int(found[1]) << 10 if found else 0)
                time.sleep(0.005)
        said.seek(0)
        return process.returncode, highest, said.read()


def test_a_bake_keeps_to_the_memory_it_is_allowed(scene: Scene, tmp_path: Path) -> None:
    """What it refuses to go below is enough, and the frame is the same, bit for bit."""
    shot = enlarged(scene, tmp_path, 30)
    code, _, errors = baked_within(scene, shot, tmp_path / "none", "--max-memory", "0.1")
    told = re.search(r"--max-memory is 0.1 GB, and this bake takes ([\d.]+) at least: .* 960x720", errors)
    assert code == 2 and told and not list((tmp_path / "none").glob("*.exr")), errors
    least = float(told[1])
    code, highest, errors = baked_within(scene, shot, tmp_path / "little", "--max-memory", f"{least}")
    assert code == 0 and highest <= least * 2**30, (errors, highest / 2**30, least)
    assert baked_within(scene, shot, tmp_path / "much")[0] == 0
    little, much = (read_frame(tmp_path / name / "walk_-0001.exr")[0] for name in ("little", "much"))
    np.testing.assert_array_equal(little.combined, much.combined)
    np.testing.assert_array_equal(little.depth, much.depth)

"""A worker that works for long holds no more memory and no more files than in the beginning, and is as fast.

``CHONA_LONG_MINUTES`` is for how long it trains: a minute without it, an hour with ``make test-faults``.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cli_files import write_tiny_shot
from fault_runs import bake_words, start, train_words
from fault_scene import Scene
from tiny_runs import FAST

pytestmark = [
    pytest.mark.faults, pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc"),
]  # fmt: skip
FRAMES = 1000
WARM = 0.05
"""Share of the work that is not looked at: kernels are loaded, and memory is asked for the first time."""

GROWTH, SLOWDOWN = 0.05, 0.10
"""Of memory between the first tenth after that and the last, and of the seconds a step takes within a phase."""
PHASES = (WARM, FAST.skin_from, FAST.fine_from, 1.0)
"""Shares of a training's schedule at which its steps become other ones: skinning is learned, rays are followed more
finely. Only steps of one kind tell whether a process has grown slow."""


@dataclass(frozen=True)
class Course:
    """What was seen of a process at each of its events: what was done, when, the memory it held, and its files."""

    done: np.ndarray
    seconds: np.ndarray
    megabytes: np.ndarray
    files: np.ndarray

    def between(self, begin: float, end: float) -> slice:
        """Events between two shares of the time."""
        share = (self.seconds - self.seconds[0]) / (self.seconds[-1] - self.seconds[0])
        return slice(*(int(each) for each in np.searchsorted(share, [begin, end])))

    def pace(self, part: slice) -> float:
        """Seconds of a step where the computer was least busy otherwise: the lower tenth from event to event."""
        return float(np.percentile(np.diff(self.seconds[part]) / np.diff(self.done[part]), 10))


def follow(words: list[str]) -> Course:
    """Runs a program that must succeed, and looks at it with each of its progress events."""
    seen: list[tuple[float, float, float, int]] = []
    with start(words) as process:
        assert process.stdout is not None and process.stderr is not None
        for line in process.stdout:
            event = json.loads(line)
            if event["event"] == "progress":
                status = Path(f"/proc/{process.pid}/status").read_text("utf-8").splitlines()
                held = next(int(each.split()[1]) for each in status if each.startswith("VmRSS"))
                files = len(list(Path(f"/proc/{process.pid}/fd").iterdir()))
                step = event["message"].removeprefix("step ") if event["job"] == "train" else event["done"]
                if not seen or float(step) > seen[-1][0]:  # the last is told twice
                    seen.append((float(step), time.monotonic(), held / 1024.0, files))
        errors = process.stderr.read()
    assert process.returncode == 0, errors
    return Course(*(np.array(column) for column in zip(*seen, strict=True)))


def check_steady(course: Course, record: Callable[[str, object], None], phases: Sequence[float]) -> None:
    """Memory and files are in the end what they were in the beginning, and each phase is as fast in its last quarter as
    in its first."""
    first, last = course.between(WARM, WARM + 0.1), course.between(0.9, 1.0)
    before, after = (float(np.median(course.megabytes[part])) for part in (first, last))
    # Not the most: whoever looks while a checkpoint is written sees its file as well.
    few, many = (float(np.median(course.files[part])) for part in (first, last))
    record("megabytes", f"{before:.1f} to {after:.1f}")
    record("files", f"{few:g} to {many:g}")
    paces = []
    for begin, end in pairwise(phases):
        quarter = (end - begin) / 4
        paces.append([course.pace(course.between(a, a + quarter)) for a in (begin, end - quarter)])
    record("milliseconds", ", ".join(f"{1e3 * quick:.2f} to {1e3 * slow:.2f}" for quick, slow in paces))
    assert after < before * (1.0 + GROWTH)
    assert many <= few
    assert all(slow < quick * (1.0 + SLOWDOWN) for quick, slow in paces), paces


@pytest.mark.timeout(3600)
def test_a_thousand_frames_of_one_worker(
    scene: Scene, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    shot = write_tiny_shot(tmp_path / "walk.shot.npz", scene.capture, frames=FRAMES)
    course = follow(bake_words(scene.model, shot, tmp_path / "out"))
    assert len(list((tmp_path / "out").glob("*.exr"))) == FRAMES and course.done[-1] == FRAMES
    check_steady(course, record_property, (WARM, 1.0))


@pytest.mark.timeout(6 * 3600)
def test_a_long_training(
    scene: Scene, tmp_path: Path, often: Callable[[int, int], int], record_property: Callable[[str, object], None]
) -> None:
    """A checkpoint is written ten times a second, as often as it could ever leave something behind."""
    minutes = float(os.environ.get("CHONA_LONG_MINUTES", often(1, 60)))
    words = train_words(scene.capture, tmp_path / "run", 1)
    at = words.index("--steps")
    course = follow([*words[:at], "--minutes", f"{minutes:g}", *words[at + 2 :]])
    check_steady(course, record_property, PHASES)

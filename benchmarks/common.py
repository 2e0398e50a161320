"""What the benchmarks share: paired timings, the capture and the model, results on the disk."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from chona_model.camera import Camera
from chona_model.data.dataset import Dataset, Pose, View
from chona_model.data.opener import open_dataset
from chona_model.evaluate.run import machine
from chona_model.formats.atomic import write_bytes
from chona_model.formats.shot import Shot, ShotActor
from chona_model.grid_actor import GridActor
from chona_model.model_store import load_actor

RESULTS = Path(__file__).resolve().parent / "results"
DEMO = RESULTS.parents[1] / "demo" / "out" / "capture"
MODEL = RESULTS / "model.safetensors"
"""What ``training`` leaves for the other subjects."""


@dataclass(frozen=True)
class Bench:
    """What is measured.

    Attributes:
        data, format: a capture; train, test: its sequences to learn from, and those that training never sees.
        model: a model of preset fast, trained on ``train``; exact: one of preset paper, or None.
        tava: a checkout of TAVA, or None.
        minutes: length of the training that is measured; runs: of every timing; view: of the test's views.
    """

    data: Path
    format: str
    train: tuple[str, ...]
    test: tuple[str, ...]
    model: Path
    exact: Path | None
    tava: Path | None
    minutes: float
    runs: int
    view: int

    @classmethod
    def of(cls, chosen: argparse.Namespace) -> Bench:
        """What ``parser``'s options name."""
        return cls(
            chosen.data, chosen.format, tuple(chosen.train.split(",")), tuple(chosen.test.split(",")), chosen.model,
            chosen.exact, chosen.tava, chosen.minutes, chosen.runs, chosen.view,
        )  # fmt: skip

    def dataset(self, sequences: Sequence[str]) -> Dataset:
        """Some sequences of the capture."""
        return open_dataset(self.data, self.format, sequences=sequences)

    def seen(self) -> tuple[GridActor, View]:
        """The trained model and the view it is timed on."""
        if not self.model.is_file():
            raise SystemExit(
                f"there is no model {self.model}; run the subject 'training' first, or name one with --model"
            )
        actor = load_actor(self.model)
        if not isinstance(actor, GridActor):
            raise SystemExit(f"{self.model} is not a model of preset fast; train one, or name it with --model")
        return actor, self.dataset(self.test).views[self.view]


def milliseconds(runs: int, *works: Callable[[], object]) -> list[float]:
    """Median milliseconds of each of ``works``, run in turn so that a loud neighbour disturbs all alike.

    The first round does not count: it compiles, or loads what was compiled.
    """
    seconds: list[list[float]] = [[] for _ in works]
    for turn in range(runs + 1):
        for row, work in zip(seconds, works, strict=True):
            began = time.perf_counter()
            work()
            if turn:
                row.append(time.perf_counter() - began)
    return [1e3 * median(row) for row in seconds]


def ratio(runs: int, one: Callable[[], object], other: Callable[[], object]) -> float:
    """Median over paired runs of what ``other`` takes as a multiple of ``one``."""
    pairs = []
    for turn in range(runs + 1):
        began = time.perf_counter()
        one()
        middle = time.perf_counter()
        other()
        if turn:
            pairs.append((time.perf_counter() - middle) / (middle - began))
    return median(pairs)


def with_border(camera: Camera, share: float) -> Camera:
    """The same view with an empty border around it: ``share`` more pixels along each axis."""
    width, height = round(camera.width * (1 + share)), round(camera.height * (1 + share))
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, 2] += (width - camera.width) / 2, (height - camera.height) / 2
    return replace(camera, intrinsics=intrinsics, width=width, height=height)


def filling(camera: Camera, width: int, height: int, zoom: float, centre: np.ndarray) -> Camera:
    """A view of ``width`` x ``height`` pixels from the same place, ``zoom`` times closer on the pixel ``centre``."""
    scale = zoom * width / camera.width
    intrinsics = camera.intrinsics.copy()
    intrinsics[0, 0], intrinsics[1, 1] = scale * intrinsics[0, 0], scale * intrinsics[1, 1]
    offset = camera.intrinsics[:2, 2] - centre
    intrinsics[:2, 2] = np.array([width, height]) / 2 + scale * offset
    return replace(camera, intrinsics=intrinsics, width=width, height=height)


def held_shot(pose: Pose, camera: Camera, bones: tuple[str, ...], frames: int = 1) -> Shot:
    """A shot of one pose and camera, held for some frames."""

    def held(array: np.ndarray) -> np.ndarray:
        return np.stack([array] * frames)

    actor = ShotActor(
        "actor", pose.person, pose.objects, bones, held(pose.world_from_bone), held(pose.world_from_object)
    )
    return Shot(
        "held", 24.0, camera.width, camera.height, camera.kind, np.arange(frames), held(camera.intrinsics),
        held(camera.world_from_camera), held(np.array([0.01, 100.0])), (actor,),
    )  # fmt: skip


def save(name: str, rows: dict[str, Any]) -> None:
    """Writes ``results/NAME.json`` and shows it."""
    content = {"command": " ".join(["python", "-m", "benchmarks", *_shown(sys.argv[1:])]), "machine": machine(), **rows}
    RESULTS.mkdir(exist_ok=True)
    write_bytes(RESULTS / f"{name}.json", (json.dumps(content, indent=1) + "\n").encode())
    sys.stdout.write(f"{name}: {json.dumps(rows)}\n")
    sys.stdout.flush()


def _shown(words: Sequence[str]) -> list[str]:
    """The command's words with folders of this machine left out: their last part says enough."""
    return [Path(word).name if "/" in word and not word.startswith("-") else word for word in words]


def parser() -> argparse.ArgumentParser:
    """Options of every benchmark."""
    made = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    made.add_argument("--data", type=Path, default=DEMO, metavar="DIR", help="a capture (default: the demo's)")
    made.add_argument("--format", default="auto")
    made.add_argument(
        "--train", default="Robin_crate_lift", metavar="A,B", help="sequences that the model was trained on"
    )
    made.add_argument("--test", default="Robin_crate_turn", metavar="C", help="sequences that training never sees")
    made.add_argument("--model", type=Path, default=MODEL, metavar="FILE", help="default: what 'training' left")
    made.add_argument("--exact", type=Path, metavar="FILE", help="a model of preset paper")
    made.add_argument("--tava", type=Path, metavar="DIR", help="a checkout of github.com/facebookresearch/tava")
    made.add_argument("--minutes", type=float, default=1.0, metavar="M", help="of the training that is measured")
    made.add_argument("--runs", type=int, default=9, metavar="N", help="of every timing")
    made.add_argument("--view", type=int, default=5, metavar="N", help="which of the test's views is timed")
    return made

"""What ``chona estimate`` says of a bake, and what the bake then takes: seconds of whole commands, start included."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.common import Bench, save
from chona_model.data.dataset import Pose, View
from chona_model.formats.model_file import read_header
from chona_model.formats.shot import Shot, ShotActor, write_shot
from chona_model.model_store import load_actor

FRAMES = 24
ROUNDS = 3
PRESETS = ("draft", "preview", "final")
NEARER, FARTHER = 0.8, 1.5
"""The camera goes from one to the other times its distance, so that frames differ in what they cost."""


def measure(bench: Bench) -> None:
    """Writes ``estimate.json``: for every preset what was said before a bake with it, and how long that took.

    Rounds are taken in turn, so that a loud neighbour disturbs all presets alike; medians over them are compared.
    """
    with tempfile.TemporaryDirectory(prefix="chona-") as place:
        folder = Path(place)
        model, shot = folder / "model.safetensors", folder / "dolly.shot.npz"
        shutil.copy(bench.model, model)
        write_shot(shot, dolly(list(bench.dataset(bench.test).views), load_actor(model).skeleton.names))
        if read_header(model).trade is None:
            where = ["--data", bench.data, "--format", bench.format, "--sequences", ",".join(bench.test)]
            _chona("trade", "--model", model, *where, "--out", folder / "trade", "--minutes", bench.minutes)
        said: dict[str, list[dict[str, Any]]] = {name: [] for name in PRESETS}
        taken: dict[str, list[float]] = {name: [] for name in PRESETS}
        for _ in range(ROUNDS):
            for name in PRESETS:
                wanted = ["--model", model, "--shot", shot, "--preset", name]
                said[name].append(_chona("estimate", *wanted)[0])
                event, seconds = _chona("bake", *wanted, "--out", folder / name, "--overwrite")
                assert event["written"] == FRAMES and not event["repeated"], event
                taken[name].append(seconds)
        save("estimate", {"frames": FRAMES, "rounds": ROUNDS,
                          "presets": {name: _row(name, said, taken[name]) for name in PRESETS}})  # fmt: skip


def _row(name: str, said: dict[str, list[dict[str, Any]]], taken: list[float]) -> dict[str, Any]:
    """One preset's medians; ``off`` is the median of what each estimate was off by, as a share of the true time."""
    predicted = [each["presets"][name]["total_seconds"] for each in said[name]]
    # One estimate shows all presets, whichever it was calibrated with: what it said of those is measured too.
    beside = [e["presets"][name]["total_seconds"] for other in said if other != name for e in said[other]]
    return {
        "predicted_seconds": round(median(predicted), 2),
        "true_seconds": round(median(taken), 2),
        "of_medians": round(median(predicted) / median(taken) - 1.0, 3),
        "off": round(median(abs(p / t - 1.0) for p, t in zip(predicted, taken, strict=True)), 3),
        "off_in_each_round": [round(p / t - 1.0, 3) for p, t in zip(predicted, taken, strict=True)],
        "calibrated_with_others": round(median(beside) / median(taken) - 1.0, 3),
        "start_seconds": round(median(each["start_seconds"] for each in said[name]), 2),
        "seconds_per_frame": round(median(each["presets"][name]["seconds_per_frame"] for each in said[name]), 3),
    }


def dolly(views: list[View], bones: tuple[str, ...]) -> Shot:
    """A shot of poses that training did not see, in ``FRAMES`` frames no two of which show the same."""
    # Pushed along a little, so that no pose comes twice: one that is held costs less.
    poses = [_pushed(views[index % len(views)].pose, 1e-3 * index) for index in range(FRAMES)]
    camera = views[0].camera
    placed = np.stack([camera.world_from_camera] * FRAMES)
    centre = np.mean([pose.world_from_object[0, :3, 3] for pose in poses], axis=0)
    apart = camera.world_from_camera[:3, 3] - centre
    placed[:, :3, 3] = centre + apart * np.linspace(NEARER, FARTHER, FRAMES)[:, None]
    actor = ShotActor(
        "actor", poses[0].person, poses[0].objects, bones,
        np.stack([pose.world_from_bone for pose in poses]), np.stack([pose.world_from_object for pose in poses]),
    )  # fmt: skip
    return Shot(
        "dolly", 24.0, camera.width, camera.height, camera.kind, np.arange(FRAMES),
        np.stack([camera.intrinsics] * FRAMES), placed, np.array([[0.01, 100.0]] * FRAMES), (actor,),
    )  # fmt: skip


def _pushed(pose: Pose, metres: float) -> Pose:
    bones, things = pose.world_from_bone.copy(), pose.world_from_object.copy()
    bones[:, 0, 3] += metres
    things[:, 0, 3] += metres
    return replace(pose, world_from_bone=bones, world_from_object=things)


def _chona(*arguments: object) -> tuple[dict[str, Any], float]:
    """What a command has to say in the end, and its seconds from start to end."""
    command = [sys.executable, "-m", "chona_model", *map(str, arguments), "--device", "cpu", "--progress", "json"]
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - began
    if done.returncode:
        raise SystemExit(f"chona {arguments[0]} failed: {done.stderr}")
    return json.loads(done.stdout.splitlines()[-1]), seconds

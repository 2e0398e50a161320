"""Peak memory of whole processes: frames at 1080p and 4k that the figure fills, and training."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np

from benchmarks.common import Bench, filling, save
from chona_model.settings import RENDER_PRESETS

SIZES = {"1080p": (1920, 1080), "4k": (3840, 2160)}
CLOSE = 3.0
"""How much closer than in the capture: the figure fills most of the picture."""

LIMIT_SECONDS = 1800


def measure(bench: Bench) -> None:
    """Writes ``memory.json``; every figure is of a process of its own."""
    rows: dict[str, Any] = {}
    for name in (*SIZES, "training"):
        words = ["--data", str(bench.data), "--format", bench.format, "--train", ",".join(bench.train)]
        words += ["--test", ",".join(bench.test), "--model", str(bench.model), "--view", str(bench.view)]
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.memory_case", name, *words], capture_output=True, text=True, check=True,
            timeout=LIMIT_SECONDS,
        )  # fmt: skip
        covered, peak = done.stdout.split()[-2:]
        rows[name] = {"peak_gib": float(peak)} | ({} if name == "training" else {"covered_share": float(covered)})
    save("memory", rows)


def frame(bench: Bench, name: str) -> float:
    """Renders one full picture; the share of its pixels that show the figure."""
    actor, view = bench.seen()
    small = actor.render(view.pose, view.camera, RENDER_PRESETS["draft"])
    rows, columns = np.nonzero(small.alpha > 0.5)
    camera = filling(view.camera, *SIZES[name], CLOSE, np.array([columns.mean(), rows.mean()]))
    return float((actor.render(view.pose, camera, RENDER_PRESETS["final"]).alpha > 0).mean())


def training(bench: Bench, steps: int = 150) -> None:
    """Trains for some steps, skinning included."""
    from chona_model.train.fast_settings import FastSettings
    from chona_model.train.grid_trainer import GridTrainer

    trainer = GridTrainer(bench.dataset(bench.train), FastSettings(), 0)
    for step in range(steps):
        trainer.step(step, step / steps)

"""Quality on views that training never sees, against seconds of training (preset ``fast``)."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.common import MODEL, Bench, save
from chona_model.data.dataset import Dataset
from chona_model.data.images import load_pixels
from chona_model.evaluate.metrics import score
from chona_model.grid_actor import GridActor
from chona_model.model_store import save_actor
from chona_model.settings import RENDER_PRESETS
from chona_model.train.fast_settings import FastSettings
from chona_model.train.grid_trainer import GridTrainer

MARKS = (5, 10, 15, 30, 60, 120, 180, 300, 600)
"""Seconds of training at which the model is scored; scoring takes no time from training."""

VIEWS, PRESET, WARM_UP = 8, "preview", 6


def measure(bench: Bench) -> None:
    """Writes ``training.json`` and ``training.png``. Set-up is told apart; kernels are compiled before."""
    data, test = bench.dataset(bench.train), bench.dataset(bench.test)
    warm = GridTrainer(data, FastSettings(), 1)
    for step in range(WARM_UP):
        warm.step(step, 0.0 if step < WARM_UP // 2 else 0.9)
    _scores(warm, test)
    began = time.perf_counter()
    trainer = GridTrainer(data, FastSettings(), 0)
    ready = time.perf_counter() - began
    budget, spent, step = 60.0 * bench.minutes, 0.0, 0
    rows = []
    for mark in (mark for mark in MARKS if mark <= budget):
        while spent < mark:
            start = time.perf_counter()
            trainer.step(step, min(spent / budget, 1.0))
            spent, step = spent + time.perf_counter() - start, step + 1
        whole, box = _scores(trainer, test)
        rows.append({"seconds": round(spent, 1), "steps": step, "psnr": round(whole, 2), "psnr_box": round(box, 2)})
    model = GridActor(trainer.model)
    save_actor(MODEL, model, "chona", {"preset": "fast"}, {"steps": step, "seconds": round(spent, 1)})
    save("training", {"set_up_seconds": round(ready, 2), "schedule_minutes": bench.minutes, "views": VIEWS,
                      "preset": PRESET, "curve": rows})  # fmt: skip
    _plot(rows)


def _scores(trainer: GridTrainer, dataset: Dataset) -> tuple[float, float]:
    """Mean PSNR of some views, whole and inside the masks' box, dB."""
    for index in range(len(trainer.model.persons)):
        trainer.model.volume(index).rendering_weights = None
    actor, rows = GridActor(trainer.model), []
    for index in np.linspace(0, len(dataset.views) - 1, VIEWS).astype(int):
        view = dataset.views[index]
        pixels = load_pixels(view)
        picture = actor.render(view.pose, view.camera, RENDER_PRESETS[PRESET])
        result = score(np.clip(picture.rgb, 0.0, 1.0), pixels.rgb, pixels.mask)
        rows.append((result.psnr, result.psnr_box if result.psnr_box is not None else result.psnr))
    whole, box = np.mean(rows, axis=0)
    return float(whole), float(box)


def _plot(rows: list[dict[str, float]]) -> None:
    from benchmarks.plots import line

    names = {"psnr": "whole picture", "psnr_box": "inside the masks' box"}
    curves = {title: [row[name] for row in rows] for name, title in names.items()}
    line("training", [row["seconds"] for row in rows], curves, "seconds of training", "PSNR of unseen views, dB", True)

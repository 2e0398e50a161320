"""Frames of a trained model: every preset's time, its parts, and its distance from the exact preset."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.common import Bench, milliseconds, save
from chona_model.data.images import load_pixels
from chona_model.evaluate.metrics import psnr
from chona_model.grid_view import render_view
from chona_model.render.posed import depth_spans, window_of
from chona_model.settings import PRESETS, RENDER_PRESETS

COMPARED = 6
"""Views on which presets are compared with the exact one, which takes seconds a view."""


def measure(bench: Bench) -> None:
    """Writes ``frames.json``."""
    actor, view = bench.seen()
    rows: dict[str, Any] = {}
    for name in PRESETS[:3]:
        settings = RENDER_PRESETS[name]
        camera = view.camera.scaled(settings.resolution)
        ready: Any = actor.ready(view.pose, settings)
        window = window_of(ready.part, ready.figure.figure, camera)

        def new_pose(settings=settings) -> None:
            actor.forget_poses()
            actor.render(view.pose, view.camera, settings)

        def make(settings=settings) -> None:
            actor.forget_poses()
            actor.ready(view.pose, settings)

        def same(settings=settings) -> None:
            actor.render(view.pose, view.camera, settings)

        def spans(ready=ready, camera=camera, window=window) -> None:
            depth_spans(ready.part, ready.figure.figure, camera, window)

        times = milliseconds(bench.runs, new_pose, same, make, spans)
        seen = render_view(actor.model, ready, camera, settings, window)
        rays = len(seen.rows) * settings.supersampling**2
        rows[name] = dict(zip(("new_pose_ms", "same_pose_ms", "ready_ms", "spans_ms"), map(_round, times), strict=True))
        rows[name] |= {"rays": rays, "evaluations": seen.evaluated, "rays_per_second": round(rays / times[1] * 1e3)}
    save("frames", {"view": view.label, "size": [view.camera.width, view.camera.height], "presets": rows,
                    "quality": _quality(bench)})  # fmt: skip


def _quality(bench: Bench) -> dict[str, Any]:
    """PSNR against the pictures, and against the exact preset, over some views."""
    actor, _ = bench.seen()
    views = bench.dataset(bench.test).views
    truth: dict[str, list[float]] = {name: [] for name in PRESETS}
    apart: dict[str, list[float]] = {name: [] for name in PRESETS[:3]}
    for index in np.linspace(0, len(views) - 1, COMPARED).astype(int):
        view = views[index]
        target = load_pixels(view).rgb
        shown = {
            name: np.clip(actor.render(view.pose, view.camera, RENDER_PRESETS[name]).rgb, 0, 1) for name in PRESETS
        }
        for name, picture in shown.items():
            truth[name].append(psnr(picture, target))
            if name != "exact":
                apart[name].append(psnr(picture, shown["exact"]))
    return {
        "views": COMPARED,
        "psnr": {name: _round(float(np.mean(values))) for name, values in truth.items()},
        "psnr_to_exact": {name: _round(float(np.mean(values))) for name, values in apart.items()},
    }


def _round(value: float) -> float:
    return round(value, 2)

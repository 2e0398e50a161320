"""The exact path, every start followed or led, beside TAVA's own code on the same rays in the same run.

TAVA renders 64 + 64 samples a ray on two levels, ours 64 on one. Objects are not known to TAVA: rays farther than
``DISTANCE`` from every bone are dropped by it and cost nothing, yet count as its rays; so do all covered pixels of the
extrapolated frame. What TAVA itself would trace of the whole frame, every ray near a bone, is told apart. Our ``final``
renders the frame whole, with a pose it has not seen, at four rays a pixel; the others cast one. Cores kept busy tell
whether the machine was free.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np
import torch

from benchmarks import tava as harness
from benchmarks.common import Bench, save
from chona_model.data.dataset import View
from chona_model.exact_actor import ExactActor, make_rays
from chona_model.model_store import load_actor
from chona_model.render.bounds import figure_spans
from chona_model.settings import RENDER_PRESETS, ExactSettings

RUNS, FINAL_RUNS = 3, 5
"""Timed runs of the slow contestants and of our ``final``; they take turns."""

RAYS, LED_RAYS, TRAIN_RAYS, SAMPLES = 256, 1024, 64, 64
"""A frame has thousands of rays: the grid that leads starts is made once for all of ``LED_RAYS``."""

Work = Callable[[], object]


def measure(bench: Bench) -> None:
    """Writes ``exact.json``; what has no model or checkout is left out."""
    actor, view = bench.seen()
    final = RENDER_PRESETS["final"]

    def frame() -> object:
        actor.forget_poses()
        return actor.render(view.pose, view.camera, final)

    covered = np.argwhere(actor.render(view.pose, view.camera, final).alpha > 0)
    order = covered[np.random.default_rng(0).permutation(len(covered))]
    pixels = order[:RAYS]
    report: dict[str, Any] = {}
    works: dict[str, tuple[int, Work]] = {}
    if bench.exact is not None:
        for name, preset, some in (("exact_every_start", "exact", pixels), ("exact_led", "final", order[:LED_RAYS])):
            settings = replace(RENDER_PRESETS[preset].exact, samples=SAMPLES)
            works[name] = (len(some), exact_work(bench, view, some, settings))
            report[name] = {}
    if bench.tava is not None:
        for name, count, work, facts in tava_works(bench, view, pixels):
            works[name], report[name] = (count, work), facts
    for _, work in works.values():
        work()
    report["final"] = {}
    for values in report.values():
        values |= {"seconds": [], "processor_seconds": []}
    for run in range(FINAL_RUNS):
        run_once(frame, report["final"])
        for name, (_, work) in works.items() if run < RUNS else ():
            run_once(work, report[name])
    _rates(report, {name: count for name, (count, _) in works.items()}, len(covered))
    save("exact", {"view": view.label, "covered_pixels": len(covered), **report})


def _rates(report: dict[str, Any], rays: dict[str, int], covered: int) -> None:
    for name, values in report.items():
        seconds, busy = values.pop("seconds"), values.pop("processor_seconds")
        values["cores_busy"] = round(sum(busy) / sum(seconds), 2)
        if name == "final":
            values["frame_seconds"] = round(median(seconds), 4)
            continue
        values["rays"] = rays[name]
        if name == "tava_render":
            values["kept_seconds"] = round(median(seconds) / values["kept"], 4)
        values["rays_per_second"] = round(rays[name] / median(seconds), 2)
        values["rays_per_processor_second"] = round(rays[name] / median(busy), 2)
        if name != "tava_train":
            values["frame_seconds"] = round(covered / values["rays_per_second"], 1)
    if "tava_render" in report:
        theirs = report["tava_render"]
        theirs["whole_frame_seconds"] = round(theirs["rays_of_a_frame"] * theirs["kept_seconds"], 1)
        for name in report.keys() - {"tava_render", "tava_train"}:
            times = theirs["frame_seconds"] / report[name]["frame_seconds"]
            report[name]["times_as_fast_as_tava"] = round(times, 1)
        times = theirs["whole_frame_seconds"] / report["final"]["frame_seconds"]
        report["final"]["times_as_fast_as_tavas_whole_frame"] = round(times, 1)


def exact_work(bench: Bench, view: View, pixels: np.ndarray, settings: ExactSettings) -> Work:
    """Rendering ``pixels`` [R, 2] (rows, columns) by the exact path; its grids of starts are made anew every time."""
    actor = load_actor(bench.exact) if bench.exact is not None else None
    if not isinstance(actor, ExactActor):
        raise SystemExit(f"{bench.exact} is not a model of preset paper")
    figure, rig, poses = actor.figure(view.pose)
    near, far = figure_spans(figure, rig, actor.boxes(view.pose.objects), view.camera)
    rows, columns = pixels.T
    model = actor.model.eval()
    rays = make_rays(
        figure, view.camera, np.stack([columns, rows], axis=-1) + 0.5, near[rows, columns], far[rows, columns],
        next(model.parameters()), pose=0,
    )  # fmt: skip
    persons, things = poses.persons.expand(len(rows)), poses.objects.expand(len(rows), -1)

    def work() -> object:
        return model.render_rays(rays, replace(poses), persons, things, settings)

    return work


def tava_works(bench: Bench, view: View, pixels: np.ndarray) -> list[tuple[str, int, Work, dict[str, Any]]]:
    """TAVA's rendering and its training step, with what an untimed run found."""
    assert bench.tava is not None
    code = harness.import_tava(bench.tava)
    shot = harness.make_shot(code, bench.dataset(bench.test), view, pixels)
    seen, taught = (shot.part(code, 0, count) for count in (len(pixels), TRAIN_RAYS))
    model = harness.make_model(code, shot)
    optimizer = torch.optim.Adam(model.parameters(), lr=harness.LEARNING_RATE / 100, weight_decay=0.0)
    works: list[tuple[str, int, Work]] = [
        ("tava_render", len(pixels), lambda: harness.render(model, code, seen)),
        ("tava_train", TRAIN_RAYS, lambda: harness.train(model, optimizer, taught)),
    ]
    camera = view.camera
    everywhere = np.argwhere(np.ones((camera.height, camera.width), dtype=bool))
    near = harness.selected(code, harness.make_shot(code, bench.dataset(bench.test), view, everywhere))
    facts: dict[str, dict[str, Any]] = {"tava_render": {"rays_of_a_frame": int(near.sum())}, "tava_train": {}}
    return [(name, count, work, facts[name] | harness.counted(model, work)) for name, count, work in works]


def run_once(work: Work, values: dict[str, Any]) -> None:
    """Appends the ``seconds`` and the ``processor_seconds`` of all threads that one call takes."""
    began, busy = time.perf_counter(), time.process_time()
    work()
    values["seconds"].append(time.perf_counter() - began)
    values["processor_seconds"].append(time.process_time() - busy)

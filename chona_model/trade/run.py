"""``chona trade``: measures a model's settings within a time, and finds the best for what is asked."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from chona_model.actor import Actor
from chona_model.data.dataset import Dataset, DatasetError, View
from chona_model.evaluate.run import check_identities, machine
from chona_model.formats.model_file import file_hash, read_header, write_trade
from chona_model.methods import method_of
from chona_model.model_store import load_actor
from chona_model.presets import check_name, every_preset, save_preset
from chona_model.progress import Progress
from chona_model.settings import RENDER_PRESETS, RenderSettings, SettingsError
from chona_model.trade.choose import choose, descend
from chona_model.trade.cost import fit_cost
from chona_model.trade.knobs import BASE, knobs_of
from chona_model.trade.measure import Bench, Measured, measure_all
from chona_model.trade.perceptual import find_lpips
from chona_model.trade.plot import plot
from chona_model.trade.report import Trade, summary, write_json

MINUTES, FULL_MINUTES = 3.0, 40.0
LEAST_VIEWS, MOST_VIEWS, COMBINED_VIEWS = 2, 24, 4
KNOBS_SHARE = 0.75
"""Of the time for presets and knobs alone; the rest is for settings that combine them."""

EXACT_COST = 20
"""How many ``final`` frames ``exact`` takes, roughly: only to guess what fits the time."""

SCALES = (1.0, 0.5, 0.25, 0.125, 0.0625)
LEAST_PIXELS = 64
"""Pixels of the figure under which a picture says nothing: rather measure for longer."""


@dataclass(frozen=True)
class TradeRun:
    """What to measure and to look for.

    Attributes:
        minutes: for all of it; full: every value of every knob.
        image_scale: largest share of the views' size that is measured.
        seconds_per_frame, psnr: what is asked of the settings, or None.
        save_as: name for them as a preset, or None.
        keep: whether the result is put into the model file.
        device: as everywhere.
    """

    minutes: float | None = None
    full: bool = False
    image_scale: float = 1.0
    seconds_per_frame: float | None = None
    psnr: float | None = None
    save_as: str | None = None
    keep: bool = True
    device: str = "cpu"

    @property
    def budget(self) -> float:
        """Seconds."""
        return 60.0 * (self.minutes or (FULL_MINUTES if self.full else MINUTES))


def measure_trade(model: Path, dataset: Dataset, out: Path, run: TradeRun, progress: Progress) -> Trade:
    """Measures, writes ``OUT/trade.json`` and ``OUT/trade.png``, and puts a summary into the model file.

    Raises:
        DatasetError: no views, or identities the model does not know.  ModelFileError: the model cannot be loaded.
        SettingsError: nothing meets what was asked (everything measured is written first), or the name is taken.
    """
    if run.save_as is not None:
        check_name(run.save_as)
    dataset = method_of(read_header(model).method).dataset(dataset)
    if not dataset.views:
        raise DatasetError("there is not one view to measure on; check the folder and --sequences with check-data")
    actor = load_actor(model, run.device)
    check_identities(dataset, actor.persons, actor.objects)
    began, digest = time.perf_counter(), file_hash(model)
    views = [dataset.views[index] for index in spread(len(dataset.views))[:MOST_VIEWS]]
    progress.start("trade", run.budget, unit="s")

    def spent(words: str) -> float:
        seconds = time.perf_counter() - began
        progress.update(round(min(seconds, run.budget), 1), words)
        return seconds

    presets = every_preset()
    knobs = knobs_of(actor.kind, run.full)
    settings = presets | {_key(index): knob.applied(RENDER_PRESETS[BASE]) for index, knob in enumerate(knobs)}
    scale = choose_scale(actor, views[0], len(settings), run.budget * KNOBS_SHARE, run.image_scale)
    bench = Bench(actor, views, scale, run.device, find_lpips())

    def tick(done: int) -> None:
        spent(f"every knob alone, view {done + 1}")
        if done == 0:
            progress.check()

    def go_on(done: int) -> bool:
        seconds = time.perf_counter() - began
        return not progress.cancelled_by_user and seconds * (done + 1) / done < run.budget * KNOBS_SHARE

    measured = measure_all(bench, settings, range(len(views)), go_on, list(presets), tick)
    alone = [(knob, measured[_key(index)]) for index, knob in enumerate(knobs)]
    combined = _combine(bench, measured[BASE], alone, lambda words: spent(words) < run.budget, progress)
    size = (views[0].camera.width, views[0].camera.height)
    trade = Trade({name: measured[name] for name in presets}, alone, combined, None, size, scale, views[0])
    chosen, problem = _chosen(trade, run)
    trade = replace(trade, chosen=chosen)
    write_json(out / "trade.json", trade, {"path": str(model), "sha256": digest}, machine())
    plot(out / "trade.png", trade)
    if run.keep and not progress.cancelled_by_user:
        write_trade(model, summary(trade, machine()))
    if problem is not None:
        raise problem
    if chosen is not None and run.save_as is not None:
        save_preset(run.save_as, chosen.settings)
    return trade


def _key(index: int) -> str:
    return f"knob {index}"


def _combine(
    bench: Bench, base: Measured, alone: Sequence[tuple[object, Measured]], go_on: Callable[[str], bool],
    progress: Progress,
) -> list[Measured]:  # fmt: skip
    """Settings of several knobs, as long as there is time."""
    found: list[Measured] = []

    def measure(settings: RenderSettings) -> Measured | None:
        if progress.cancelled_by_user or not go_on(f"{len(found)} combinations"):
            return None
        name = f"combined {len(found) + 1}"
        numbers = range(min(COMBINED_VIEWS, base.views))
        found.append(measure_all(bench, {name: replace(settings, preset=name)}, numbers, lambda _: True, [name])[name])
        return found[-1]

    descend(base, alone, measure)  # type: ignore[arg-type]
    return found


def _chosen(trade: Trade, run: TradeRun) -> tuple[Measured | None, SettingsError | None]:
    if run.seconds_per_frame is None and run.psnr is None:
        return None, None
    try:
        return choose(trade.all, run.seconds_per_frame, run.psnr), None
    except SettingsError as error:
        return None, error


def choose_scale(actor: Actor, view: View, count: int, seconds: float, largest: float) -> float:
    """The largest share of the views' size at which ``count`` settings and ``exact`` fit the time on a few views."""
    base = RENDER_PRESETS[BASE]
    rays, times = [], []
    for scale in (SCALES[-1], SCALES[-1], SCALES[-2]):  # the first compiles kernels and does not count
        actor.forget_poses()
        began = time.perf_counter()
        picture = actor.render(view.pose, view.camera.scaled(min(scale, largest)), base)
        times.append(time.perf_counter() - began)
        rays.append(picture.rays * base.supersampling**2)
    cost = fit_cost(rays[1:], times[1:])
    smallest = largest
    for scale in (largest, *(scale for scale in SCALES if scale < largest)):
        count_of = actor.count_rays(view.pose, view.camera.scaled(scale), base)
        if count_of < LEAST_PIXELS * base.supersampling**2:
            break
        smallest = scale
        if cost.seconds(count_of) * (EXACT_COST + count) * LEAST_VIEWS <= seconds:
            break
    return smallest


def spread(count: int) -> list[int]:
    """0 … count − 1 in an order whose every beginning is spread over the whole (van der Corput's)."""
    bits = max(count - 1, 1).bit_length()
    order = [int(f"{index:0{bits}b}"[::-1], 2) for index in range(1 << bits)]
    return [index for index in order if index < count]

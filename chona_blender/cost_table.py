"""The table of presets in the Bake panel, as strings: made when something has changed, and drawn as it is."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from . import estimates, model_cache, presets
from .estimates import NOT_KNOWN, Estimate
from .model_header import ModelHeader

UNMEASURED = "This model was not measured: chona trade says what its presets give"


@dataclass(frozen=True)
class Row:
    """One preset: its name, its quality, and the times of a frame and of the bake."""

    name: str
    quality: str
    frame: str
    total: str


@dataclass(frozen=True)
class Table:
    """What is known of every preset.

    Attributes:
        rows: none while nothing is known at all.
        note: whose times these are, in one line.
        stale: the estimate was made of another bake than the settings ask for now.
        problem: what the model lacks, in one line.
    """

    rows: tuple[Row, ...]
    note: str
    stale: bool
    problem: str


_last: dict[int, tuple[tuple[object, ...], Table]] = {}


def table(scene: bpy.types.Scene) -> Table:
    """The scene's table; made anew only when what it shows has changed."""
    facts, estimate, names = estimates.facts_of(scene), estimates.last(scene), tuple(presets.names())
    key = (facts, estimate, names)
    known = _last.get(scene.session_uid)
    if known is None or known[0] != key:
        known = _last[scene.session_uid] = key, _made(_header(scene), estimate, facts, names)
    return known[1]


def time_of_bake(scene: bpy.types.Scene) -> str:
    """`≈ 3 min 20 s` for the chosen preset, where the scene's estimate holds."""
    estimate = estimates.last(scene)
    cost = None if estimate is None else estimate.presets.get(scene.chona.preset)
    return "" if cost is None or table(scene).stale else f"≈ {estimates.time_words(cost.total)}"


def forget() -> None:
    """Drop everything: the add-on is switched off."""
    _last.clear()


def _header(scene: bpy.types.Scene) -> ModelHeader | None:
    """Of the first actor that is rendered: a bake names its model first."""
    actors = scene.chona.used_actors()
    return model_cache.cached(actors[0].model_path) if actors else None


def _made(
    header: ModelHeader | None, estimate: Estimate | None, facts: estimates.Facts, names: tuple[str, ...]
) -> Table:
    trade = None if header is None else header.trade
    problem = "" if header is None or trade is not None else header.trade_problem or UNMEASURED
    if estimate is None and trade is None:
        return Table((), "", False, problem)
    rows = []
    for name in names:
        figures = None if trade is None else trade["presets"].get(name)
        frame = total = NOT_KNOWN
        if estimate is not None:
            cost = estimate.presets.get(name)
            if cost is not None:
                frame, total = estimates.frame_words(cost.seconds), estimates.time_words(cost.total)
        elif figures is not None:
            frame = estimates.frame_words(figures["seconds"])
        rows.append(Row(name, estimates.quality_words(figures), frame, total))
    changed = "" if estimate is None else estimates.changes(estimate, facts)
    return Table(tuple(rows), _note(trade, estimate, changed), bool(changed), problem)


def _note(trade: dict | None, estimate: Estimate | None, changed: str) -> str:
    if estimate is None:
        width, height = trade["size"] if trade is not None else (0, 0)
        return f"Seconds a frame of {width} × {height} on the machine it was measured on"
    frames = f"{estimate.frames} frame{'s' * (estimate.frames != 1)}"
    if changed:
        return f"Out of date: estimated before {changed} changed"
    return f"On this computer, the bake of {frames} with its start"

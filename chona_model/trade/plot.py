"""The plot of a trade: seconds a frame against distance from ``exact`` and against quality, with the fronts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from chona_model.formats.atomic import atomic_path
from chona_model.trade.choose import Loss, error, front
from chona_model.trade.measure import Measured
from chona_model.trade.report import Trade

LABEL_WIDTH, LABEL_HEIGHT = 0.2, 0.05
"""Room that a knob's name takes, as shares of the axes."""


def plot(path: Path, trade: Trade) -> None:
    """Writes ``trade.png``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw(left, trade, error, 1.0, "distance from exact (RMS of colour over the figure)")
    left.set_yscale("symlog", linthresh=1e-3)
    left.legend(fontsize=8)
    _draw(right, trade, lambda measured: -measured.psnr, -1.0, "PSNR on unseen views, dB")
    views, (width, height) = max(each.views for each in trade.presets.values()), trade.size
    words = f"{views} unseen views, {width} x {height} pixels, measured at {trade.scale:g} of the size"
    figure.suptitle(words, fontsize=10)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _draw(axes: Any, trade: Trade, loss: Loss, sign: float, words: str) -> None:
    def place(measured: Measured) -> tuple[float, float]:
        return measured.full_seconds, sign * loss(measured)

    def columns(group: Sequence[Measured]) -> list[tuple[float, ...]]:
        return list(zip(*map(place, group), strict=True))

    axes.set_xscale("log")
    axes.set_xlabel("seconds a frame")
    axes.set_ylabel(words)
    axes.grid(alpha=0.25, which="both", linewidth=0.5)
    best = columns(front(trade.all, loss))
    axes.plot(*best, color="0.8", linewidth=4, zorder=1, label="front", solid_capstyle="round")
    groups = [
        ("one knob alone", [measured for _, measured in trade.knobs], "tab:blue", "o", 22),
        ("several knobs", trade.combined, "tab:green", "s", 18),
        ("preset", list(trade.presets.values()), "tab:red", "D", 46),
    ]
    for label, group, colour, marker, size in groups:
        if group:
            axes.scatter(*columns(group), s=size, color=colour, marker=marker, label=label, zorder=3)
    if trade.chosen is not None:
        axes.scatter(*columns([trade.chosen]), s=150, facecolors="none", edgecolors="black", linewidths=1.5,
                     label="chosen", zorder=4)  # fmt: skip
    for name, measured in trade.presets.items():
        axes.annotate(name, place(measured), xytext=(-6, 8), textcoords="offset points", weight="bold", ha="right")
    points = np.array([place(measured) for measured in trade.all])
    points[:, 0] = np.log10(points[:, 0])
    shares = (points - points.min(axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-9)
    taken = [tuple(share) for share in shares[: len(trade.presets)]]
    for (knob, measured), (x, y) in zip(trade.knobs, shares[len(trade.presets) :], strict=False):
        if all(abs(x - other[0]) > LABEL_WIDTH or abs(y - other[1]) > LABEL_HEIGHT for other in taken):
            taken.append((x, y))
            axes.annotate(knob.label, place(measured), xytext=(5, -9), textcoords="offset points", fontsize=7,
                          color="0.35")  # fmt: skip

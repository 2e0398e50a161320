"""Plots of results, beside their JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from benchmarks.common import RESULTS


def line(
    name: str, x: Sequence[float], rows: Mapping[str, Sequence[float]], x_label: str, y_label: str, log: bool = False
) -> None:
    """Writes ``results/NAME.png``: a line for each of ``rows`` over ``x``."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 3.6), layout="constrained")
    for label, values in rows.items():
        axes.plot(x, values, marker="o", label=label)
    if log:
        axes.set_xscale("log")
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.grid(alpha=0.3)
    if len(rows) > 1:
        axes.legend()
    figure.savefig(RESULTS / f"{name}.png", dpi=120)
    pyplot.close(figure)

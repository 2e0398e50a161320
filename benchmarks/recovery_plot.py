"""The picture of ``recovery``: what is lost, by kind of pose and by the number of starts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pictures"

LINES = {
    "newton_float32": ("Newton, float32", "tab:blue"),
    "broyden_float32": ("Broyden, float32", "tab:orange"),
    "broyden_float64": ("Broyden, float64", "tab:red"),
}


def draw(report: dict[str, Any]) -> None:
    """Writes ``docs/pictures/recovery.png``."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    kinds = report["kinds"]
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.8), layout="constrained", sharey=True)
    angles = [float(kind.split()[0]) for kind in kinds if kind.endswith("rad")]
    rows = [kinds[kind] for kind in kinds if kind.endswith("rad")]

    def lost(share: float) -> float:
        return max(100 * (1 - share), 2e-3)  # what a logarithmic axis can show

    for name, (label, colour) in LINES.items():
        for count, style in ((1, ":"), (5, "-")):
            values = [lost(row["found_by_starts"][name][count - 1]) for row in rows]
            left.plot(angles, values, style, color=colour, marker="o", ms=3, label=f"{label}, K = {count}")
        right.plot(range(1, 11), [lost(share) for share in rows[-1]["found_by_starts"][name]], color=colour, marker="o",
                   ms=3, label=f"{label}, {angles[-1]} rad")  # fmt: skip
        right.plot(range(1, 11), [lost(share) for share in rows[3]["found_by_starts"][name]], "--", color=colour,
                   marker="o", ms=3, label=f"{label}, {angles[3]} rad")  # fmt: skip
    for count, style in ((3, ":"), (5, "-")):
        values = [lost(row[f"newton_between_{count}"]) for row in rows]
        left.plot(
            angles, values, style, color="tab:green", marker="o", ms=3, label=f"Newton, a second look, K = {count}"
        )
        right.plot([count], [values[-1]], "s", color="tab:green")
        right.plot([count], [values[3]], "s", color="tab:green")
    values = [lost(row["exact"]["found"]) for row in rows]
    left.plot(angles, values, color="tab:gray", marker="x", ms=4, label="voxels, two starts")
    left.set_xlabel("random joint angles up to (rad)")
    right.set_xlabel("K, starts besides the background's (squares: with a second look)")
    left.set_ylabel("known roots lost (%)")
    left.set_yscale("log")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=6.5)
    PICTURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURES / "recovery.png", dpi=100)
    pyplot.close(figure)

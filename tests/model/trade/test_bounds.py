"""The bounds in ``docs/accuracy.md``, row by row, and the order of the presets."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from bound_cases import exact_settings, measured, picture, scene

from chona_model.settings import PRESETS, RENDER_PRESETS
from chona_model.trade.knobs import EXACT, GRID, Knob
from chona_model.trade.measure import differences

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "accuracy.md"
ROW = re.compile(
    r"\| (?P<kind>grids|paper's path) \| `(?P<name>[a-z_.+]+)` \| `(?P<value>[^`]+)` \| (?P<colour>[\d.]+) "
    r"\| (?P<alpha>[\d.]+) \| (?P<depth>[\d.]+) mm \|"
)
KINDS = {"grids": "grid", "paper's path": "exact"}

UNBOUNDED = {
    "grid": {"precision"},  # tests/model/test_grid_device.py and docs/numerics.md
    "exact": {"precision", "supersampling", "resolution", "resolution+upsampling", "exact.bounded"},
}
"""Knobs without a row: float64 has tables of its own, and the paper's path shares image-space knobs with grids."""


def rows() -> list[tuple[str, Knob, tuple[float, float, float]]]:
    """Kind, knob and bounds (colour, alpha, depth in metres) of every row of the document."""
    found = []
    for match in ROW.finditer(DOCUMENT.read_text("utf-8")):
        bounds = float(match["colour"]), float(match["alpha"]), float(match["depth"]) / 1000
        found.append((KINDS[match["kind"]], Knob(match["name"], ast.literal_eval(match["value"])), bounds))
    return found


@pytest.mark.parametrize(("kind", "knob", "bounds"), rows(), ids=lambda value: str(getattr(value, "label", "")))
def test_every_setting_stays_inside_its_bound(kind: str, knob: Knob, bounds: tuple[float, float, float]) -> None:
    found = measured(kind, knob)
    assert all(value <= bound for value, bound in zip(found, bounds, strict=True)), f"{knob.label}: {found}"
    # A bound far above what is measured would hold anything.
    assert found[0] >= bounds[0] / 12 or bounds[0] <= 0.002, f"{knob.label}: {found[0]} makes {bounds[0]} no bound"


@pytest.mark.parametrize(("kind", "table"), [("grid", GRID), ("exact", EXACT)])
def test_every_knob_has_a_row(kind: str, table: dict) -> None:
    written = {knob.name for own, knob, _ in rows() if own == kind}
    assert set(table) - UNBOUNDED[kind] == written


@pytest.mark.parametrize("kind", ["grid", "exact"])
def test_slower_presets_are_never_worse(kind: str) -> None:
    """Beyond rounding; the paper's path with one ray a pixel for all, which is what presets differ in otherwise."""
    exact = picture(kind, exact_settings(kind))
    errors = []
    for name in PRESETS:
        settings = RENDER_PRESETS[name]
        if kind == "exact":
            settings = replace(settings, supersampling=1, resolution=1.0)
        errors.append(differences(picture(kind, settings), exact)[0])
    assert all(slower <= faster + 1e-3 for faster, slower in pairwise(errors)), errors
    assert scene(kind)[0].kind == kind

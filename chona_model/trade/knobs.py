"""The approximations of a kind of model, each alone: a field of the settings and the values it is tried at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from chona_model.settings import RENDER_PRESETS, RenderSettings

BASE = "final"
"""Knobs are turned one by one from this preset."""

Values = Sequence[Any]

GRID: dict[str, tuple[Values, Values]] = {
    "step": ((0.012, 0.016), (0.004, 0.006, 0.012, 0.016, 0.024)),
    "stop": ((0.02,), (0.0, 0.02, 0.05, 0.1)),
    "newton_steps": ((2,), (1, 2, 3, 8)),
    "tolerance": ((2e-3,), (2e-5, 1e-3, 2e-3)),
    "starts": ((1,), (1,)),
    "supersampling": ((1,), (1, 3, 4)),
    "occupancy": ((False,), (False,)),
    "occupancy_threshold": ((10.0,), (5.0, 10.0, 20.0)),
    "occupancy_cell": ((2,), (2, 3)),
    "offset": ((False,), (False,)),
    "shading": ((False,), (False,)),
    "resolution": ((0.5,), (0.5, 0.25)),
    "resolution+upsampling": (((0.5, "guided"),), ((0.5, "guided"), (0.25, "guided"))),
    "precision": ((), ("float64",)),
}
"""Of models on grids: values tried in short, and with ``--full``."""

EXACT: dict[str, tuple[Values, Values]] = {
    "exact.samples": ((32,), (24, 32, 48, 96, 128)),
    "exact.inverse.starts": ((2,), (1, 2, 3, 8)),
    "exact.inverse.steps": ((8,), (5, 8, 12, 40)),
    "exact.inverse.tolerance": ((1e-4,), (1e-6, 1e-4, 1e-3)),
    "exact.inverse.predict": ((0.1,), (0.0, 0.03, 0.1)),
    "exact.inverse.background": ((False,), (False,)),
    "exact.covariance": (("plain",), ("plain",)),
    "exact.offset": ((False,), (False,)),
    "exact.shading": ((False,), (False,)),
    "exact.bounded": ((), (False,)),
    "exact.roots": (("grid",), ("grid",)),
    "exact.roots+exact.inverse.predict": ((), (("grid", 0.03), ("grid", 0.1))),
    "exact.field_precision": (("bfloat16",), ("bfloat16",)),
    "supersampling": ((1,), (1, 3)),
    "resolution": ((0.5,), (0.5,)),
    "resolution+upsampling": (((0.5, "guided"),), ((0.5, "guided"),)),
    "precision": ((), ("float64",)),
}
"""Of models of the paper's path."""


@dataclass(frozen=True)
class Knob:
    """One change of one approximation.

    Attributes:
        name: field of ``RenderSettings``, with dots into its parts; several that only make sense together joined by +.
        value: what it is set to; a tuple for several.
    """

    name: str
    value: Any

    def applied(self, settings: RenderSettings) -> RenderSettings:
        """``settings`` with this change, called after it."""
        names = self.name.split("+")
        values = self.value if len(names) > 1 else (self.value,)
        changed = settings
        for name, value in zip(names, values, strict=True):
            changed = _set(changed, name.split("."), value)
        return changed

    @property
    def label(self) -> str:
        """As people read it."""
        short = self.name.replace("exact.inverse.", "").replace("exact.", "")
        values = self.value if isinstance(self.value, tuple) else (self.value,)
        return f"{short} {' '.join(f'{value:g}' if isinstance(value, float) else str(value) for value in values)}"


def knobs_of(kind: str, full: bool) -> list[Knob]:
    """The knobs of a kind of model (``grid`` or ``exact``), without those that change nothing of the base."""
    table = GRID if kind == "grid" else EXACT
    found = [Knob(name, value) for name, values in table.items() for value in values[full]]
    base = RENDER_PRESETS[BASE]
    return [knob for knob in found if knob.applied(base) != base]


def _set(settings: Any, names: Sequence[str], value: Any) -> Any:
    if len(names) > 1:
        value = _set(getattr(settings, names[0]), names[1:], value)
    return replace(settings, **{names[0]: value})

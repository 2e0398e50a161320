"""What a measured trade is written as: ``trade.json``, lines for people, and what travels in the model file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from chona_model.data.dataset import View
from chona_model.formats.atomic import write_bytes
from chona_model.trade.choose import front
from chona_model.trade.knobs import BASE, Knob
from chona_model.trade.measure import Measured

VERSION = 1


@dataclass(frozen=True)
class Trade:
    """Everything measured of one model.

    Attributes:
        presets: by name, a user's own among them; knobs: each alone; combined: several knobs together.
        chosen: what was asked for, if anything.
        size: [width, height] of the views; scale: share of it that was measured.
        reference: the view that calibrations render.
    """

    presets: dict[str, Measured]
    knobs: list[tuple[Knob, Measured]]
    combined: list[Measured]
    chosen: Measured | None
    size: tuple[int, int]
    scale: float
    reference: View

    @property
    def all(self) -> list[Measured]:
        """Presets, knobs and combinations."""
        return [*self.presets.values(), *(measured for _, measured in self.knobs), *self.combined]

    def label(self, measured: Measured) -> str:
        """What a point is called."""
        for name, each in self.presets.items():
            if each is measured:
                return name
        for knob, each in self.knobs:
            if each is measured:
                return f"{BASE}, {knob.label}"
        return measured.settings.preset


def write_json(path: Path, trade: Trade, model: Mapping[str, Any], machine: Mapping[str, Any]) -> dict[str, Any]:
    """Writes ``trade.json`` and returns its content."""
    content = {
        "version": VERSION,
        "presets": {name: measured.as_dict() for name, measured in trade.presets.items()},
        "knobs": [
            {"knob": knob.name, "value": knob.value, "base": BASE, "label": knob.label, **measured.as_dict()}
            for knob, measured in trade.knobs
        ],
        "combined": [{**measured.as_dict(), "settings": asdict(measured.settings)} for measured in trade.combined],
        "front": [
            {"label": trade.label(measured), **measured.as_dict(), "settings": asdict(measured.settings)}
            for measured in front(trade.all)
        ],
        "chosen": _described(trade.chosen),
        "size": list(trade.size),
        "scale": trade.scale,
        "model": dict(model),
        "machine": dict(machine),
    }
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())
    return content


def _described(measured: Measured | None) -> dict[str, Any] | None:
    return None if measured is None else {**measured.as_dict(), "settings": asdict(measured.settings)}


def summary(trade: Trade, machine: Mapping[str, Any]) -> dict[str, Any]:
    """What a model file carries: presets' figures, and the view that other machines calibrate themselves on."""
    names = ("seconds", "fixed_seconds", "seconds_per_ray", "megabytes", "psnr", "ssim", "error", "error_depth")
    view = trade.reference
    return {
        "version": VERSION,
        "presets": {
            name: {key: value for key, value in measured.as_dict().items() if key in names}
            for name, measured in trade.presets.items()
        },
        "size": list(trade.size), "views": max(measured.views for measured in trade.presets.values()),
        "machine": dict(machine),
        "reference": {
            "person": view.pose.person, "objects": list(view.pose.objects),
            "world_from_bone": None if view.pose.world_from_bone is None else view.pose.world_from_bone.tolist(),
            "world_from_object": view.pose.world_from_object.tolist(),
            "intrinsics": view.camera.intrinsics.tolist(),
            "world_from_camera": view.camera.world_from_camera.tolist(),
            "width": view.camera.width, "height": view.camera.height, "kind": view.camera.kind,
        },
    }  # fmt: skip


def table(measured: Sequence[tuple[str, Measured]]) -> str:
    """Lines for people: name, seconds, dB, SSIM, error, memory."""
    width = max(len(name) for name, _ in measured)
    lines = [f"{'':<{width}}  s/frame     PSNR    SSIM    error     MB"]
    for name, each in measured:
        memory = "-" if each.megabytes is None else f"{each.megabytes:.0f}"
        quality = f"{each.psnr:7.2f}  {each.ssim:.4f}  {each.error:.4f}"
        lines.append(f"{name:<{width}}  {each.full_seconds:7.3f}  {quality}  {memory:>5}")
    return "\n".join(lines) + "\n"

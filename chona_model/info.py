"""``chona info``: what a model file says of itself, as JSON and in words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from chona_model.formats.model_file import check_trade, file_hash, read_header


def describe(path: Path) -> dict[str, Any]:
    """Everything that is known of a model file, JSON-able.

    Raises:
        ModelFileError: missing, damaged, or of another version.
    """
    header = read_header(path)
    if header.trade is not None:
        check_trade(path, header.trade)
    heights = {name: _height(person) for name, person in header.persons.items()}
    sizes = {name: _size(shape) for name, shape in header.objects.items()}
    return {
        "file": str(path), "bytes": header.size_bytes, "sha256": file_hash(path), "version": header.version,
        "method": header.method, "field": header.field,
        "skeleton": {"names": list(header.skeleton.names), "parents": list(header.skeleton.parents)},
        "persons": {name: {"joints_height": height} for name, height in heights.items()},
        "objects": {name: {"size": size} for name, size in sizes.items()},
        "object_distance": header.object_distance, "settings": header.settings, "training": header.training,
        "trade": header.trade,
    }  # fmt: skip


def to_text(description: Mapping[str, Any]) -> str:
    """A description as lines for people."""
    bones = description["skeleton"]["names"]
    persons = [
        f"{name} (joints {person['joints_height']:.2f} m high)" for name, person in description["persons"].items()
    ]
    objects = [
        f"{name} ({' x '.join(f'{edge:.2f}' for edge in shape['size'])} m)"
        for name, shape in description["objects"].items()
    ]
    lines = [
        f"file      {description['file']}",
        f"size      {description['bytes'] / 1e6:.1f} MB",
        f"sha256    {description['sha256']}",
        f"format    version {description['version']}",
        f"method    {description['method']} ({description['field']} field)",
        f"persons   {', '.join(persons) or 'none'}",
        f"objects   {', '.join(objects) or 'none'}",
        f"skeleton  {len(bones)} bones: {', '.join(bones)}",
        *_measured(description["trade"]),
        *_section("training", {name: value for name, value in description["training"].items() if name != "poses_seen"}),
        *_section("settings", description["settings"]),
    ]
    return "\n".join(lines) + "\n"


def _measured(trade: Mapping[str, Any] | None) -> list[str]:
    if trade is None:
        return ["measured  not yet: 'chona trade' says what its presets give and cost"]
    width, height = trade["size"]
    rows = [
        f"  {name}: {_decibels(each.get('psnr'))}, {each['seconds']:.2g} s a frame"
        for name, each in trade["presets"].items()
    ]
    return [f"measured  on {trade['views']} unseen views, {width} x {height} pixels", *rows]


def _decibels(psnr: float | None) -> str:
    return "no quality" if psnr is None else f"{psnr:.1f} dB"


def _section(title: str, content: Mapping[str, Any]) -> list[str]:
    return [f"{title:<9} {'' if content else 'not stated'}".rstrip(), *_lines(content, "  ")]


def _lines(content: Mapping[str, Any], indent: str) -> list[str]:
    lines = []
    for name, value in content.items():
        if isinstance(value, Mapping):
            lines += [f"{indent}{name}", *_lines(value, indent + "  ")]
        else:
            lines.append(f"{indent}{name}: {value}")
    return lines


def _height(person: Mapping[str, Any]) -> float:
    """From the lowest to the highest joint, metres."""
    joints = np.array(person["rest_joints"], dtype=np.float64)
    return round(float(np.ptp(joints[:, 1])), 4)


def _size(shape: Mapping[str, Any]) -> list[float]:
    """Edges of an object's box, metres."""
    return [round(float(edge), 4) for edge in np.subtract(shape["upper"], shape["lower"])]

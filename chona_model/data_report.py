"""What ``chona check-data`` says: a ``DataReport`` as fields, as JSON and in words."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from chona_model.data.checks import DataReport

FORMAT_NAMES = {"behave": "BEHAVE", "blender": "Blender capture", "zju_mocap": "ZJU-MoCap", "co3d": "CO3D",
                "transforms": "transforms.json"}  # fmt: skip
"""What people call a layout."""


def headline(report: DataReport, format: str) -> str:
    """``BEHAVE, 4 sequences, 2 persons, 7 objects, 1200 views``."""
    counts = (
        (len(report.sequences), "sequence"), (len(report.persons), "person"), (len(report.objects), "object"),
        (report.views, "view"),
    )  # fmt: skip
    words = [f"{count} {noun}{'s' * (count != 1)}" for count, noun in counts if count]
    return ", ".join([FORMAT_NAMES.get(format, format), *words])


def to_fields(report: DataReport, format: str) -> dict[str, Any]:
    """Every field of the report, pictures by name, with the layout's ``format`` and the ``headline``."""
    fields = {"format": format, "headline": headline(report, format), **asdict(report)}
    return json.loads(json.dumps(fields, default=str))


def to_json(report: DataReport, format: str) -> str:
    """``to_fields`` as text."""
    return json.dumps(to_fields(report, format), indent=2) + "\n"


def to_text(report: DataReport, format: str) -> str:
    """The report as lines for people: what there is, what was measured, what looks wrong."""
    lines = [
        headline(report, format),
        f"persons    {', '.join(report.persons) or 'none'}",
        f"objects    {', '.join(report.objects) or 'none'}",
        f"skeleton   {report.bones} bones",
        f"views      {report.views} in {len(report.sequences)} sequences",
    ]
    for check in (each for each in report.sequences if each.checked):
        shares = [
            f"{share:.0%} of the {part} inside the masks"
            for part, share in (("joints", check.joints_inside), ("objects' centres", check.objects_inside))
            if share is not None
        ]
        sheet = [] if check.sheet is None else [str(check.sheet)]
        lines.append(
            f"  {check.name}: {', '.join([f'{check.views} views', f'{check.checked} checked', *shares, *sheet])}"
        )
    lines += [f"warning: {warning}" for warning in report.warnings]
    if report.warnings:
        lines.append(f"{len(report.warnings)} warnings: look at them first")
    elif any(check.checked for check in report.sequences):
        lines.append("the data look right")
    return "\n".join(lines) + "\n"

"""What ``chona check-data`` says: a ``DataReport`` as JSON and in words."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from chona_model.data.checks import DataReport


def to_json(report: DataReport) -> str:
    """The report with every field, pictures by name."""

    def plain(value: Any) -> str:
        return str(value)

    return json.dumps(asdict(report), indent=2, default=plain) + "\n"


def to_text(report: DataReport) -> str:
    """The report as lines for people: what there is, what was measured, what looks wrong."""
    lines = [
        f"persons    {', '.join(report.persons) or 'none'}",
        f"objects    {', '.join(report.objects) or 'none'}",
        f"skeleton   {report.bones} bones",
        f"views      {report.views} in {len(report.sequences)} sequences",
    ]
    for check in report.sequences:
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
    lines.append(
        "the data look right" if not report.warnings else f"{len(report.warnings)} warnings: look at them first"
    )
    return "\n".join(lines) + "\n"

"""A table as it was made, beside the paper's: JSON and Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from chona_model.evaluate.run import machine
from chona_model.formats.atomic import write_bytes
from chona_model.reproduce.cell import Protocol
from chona_model.reproduce.tables import Table

Results = Mapping[tuple[str, str], Mapping[str, Any]]
"""Cells' results by row and column."""


def write_report(out: Path, name: str, table: Table, results: Results, protocol: Protocol) -> None:
    """Writes ``NAME.json`` and ``NAME.md``.

    Raises:
        OSError: a file cannot be written.
    """
    content = {
        "table": name, "title": table.title, "source": table.source, "protocol": asdict(protocol),
        "machine": machine(), "rows": _rows(table, results),
    }  # fmt: skip
    write_bytes(out / f"{name}.json", json.dumps(content, indent=1).encode())
    write_bytes(out / f"{name}.md", to_markdown(content).encode())


def _rows(table: Table, results: Results) -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for row, words in table.rows.items():
        tests = {}
        for test, column in table.tests.items():
            cell = results.get((row, column), {})
            made = cell.get("tests", {}).get(test)
            paper = words.paper.get(test)
            tests[test] = {
                "psnr": made and made["psnr"], "ssim": made and made["ssim"], "psnr_box": made and made["psnr_box"],
                "ssim_box": made and made["ssim_box"], "views": made and made["views"], "steps": cell.get("steps"),
                "paper_psnr": paper and paper[0], "paper_ssim": paper and paper[1],
            }  # fmt: skip
        rows[row] = {"label": words.label, "tests": tests}
    return rows


def to_markdown(content: Mapping[str, Any]) -> str:
    """The table in Markdown: PSNR and SSIM made here, in brackets the paper's; – where a cell was not made.

    Args:
        content: what ``NAME.json`` holds.
    """
    protocol, rows = content["protocol"], content["rows"]
    steps, frames = protocol["steps"], protocol["frames"]
    budget = f"{protocol['minutes']:g} minutes" if steps is None else f"{steps} steps"
    dry = f", {frames} frames of every identity (dry run)" if frames is not None else ""
    tests = list(next(iter(rows.values()))["tests"])
    lines = [
        f"# {content['title']}", "",
        f"{content['source']}. Every cell: {budget} of training, preset {protocol['preset']}, images x "
        f"{protocol['image_scale']:g}, rendered with {protocol['quality']}, seed {protocol['seed']}{dry}. "
        "In brackets: the paper's figures, on the real data.", "",
        "| | " + " | ".join(tests) + " | mean |",
        "|---|" + "---|" * (len(tests) + 1),
    ]  # fmt: skip
    for row, words in rows.items():
        cells, figures = [], []
        for test in words["tests"].values():
            ours = "–" if test["psnr"] is None else f"{test['psnr']:.2f} / {test['ssim']:.4f}"
            theirs = "" if test["paper_psnr"] is None else f" ({test['paper_psnr']:.1f} / {test['paper_ssim']:.3f})"
            cells.append(ours + theirs)
            figures.append((test["psnr"], test["paper_psnr"]))
        lines.append(f"| {words['label']} (`{row}`) | " + " | ".join(cells) + f" | {_mean(figures)} |")
    return "\n".join(lines) + "\n"


def _mean(figures: list[tuple[float | None, float | None]]) -> str:
    """Mean PSNR over the tests that both have, ours and the paper's; over ours where the paper has none."""
    ours = [made for made, _ in figures if made is not None]
    if not ours:
        return "–"
    both = [(made, paper) for made, paper in figures if made is not None and paper is not None]
    paper = f" ({np.mean([paper for _, paper in both]):.1f})" if both else ""
    return f"{np.mean(ours):.2f}{paper}"

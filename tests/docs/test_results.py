"""The tables of docs/results.md are those of the figures beside them."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from chona_model.reproduce.tables import read_tables

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "benchmarks" / "results").glob("reproduce-*.json"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_page_has_the_figures_of_the_file(file: Path) -> None:
    spec = importlib.util.spec_from_file_location("record_tables", ROOT / "scripts" / "record_tables.py")
    assert spec and spec.loader
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    content = json.loads(file.read_text("utf-8"))
    page = (ROOT / "docs" / "results.md").read_text("utf-8")
    assert script.with_table(page, file.stem.removeprefix("reproduce-"), script.table_of(content)) == page
    table = read_tables()[content["table"]]
    assert list(content["rows"]) == list(table.rows)
    for row, words in table.rows.items():
        for test, figures in words.paper.items():
            told = content["rows"][row]["tests"][test]
            assert (told["paper_psnr"], told["paper_ssim"]) == figures

"""Every message that docs/troubleshooting.md quotes is still said by the sources."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "troubleshooting.md"
FILLED_IN = "\0"
"""Stands where a name or a number is put into a message."""


def quoted() -> list[str]:
    """The messages in the first column of the tables, in italics."""
    cells = [line.split("|")[1] for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| *")]
    return [message for cell in cells for message in re.findall(r"\*([^*]+)\*", cell)]


@cache
def messages() -> str:
    """All texts of both packages, one a line, in small letters: the panel begins sentences with a capital."""
    files = [path for package in ("chona_blender", "chona_model") for path in sorted((ROOT / package).rglob("*.py"))]
    return "\n".join(text for path in files for text in _texts(ast.parse(path.read_text("utf-8")))).lower()


def _texts(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield " ".join(node.value.split())
        elif isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else FILLED_IN for part in node.values]
            yield " ".join("".join(map(str, parts)).split())


@pytest.mark.parametrize("message", quoted())
def test_the_sources_still_say_it(message: str) -> None:
    """The quoted words in one text, in order; `…` stands for anything that has no line break."""
    fragments = [re.escape(part.strip()) for part in message.lower().split("…")]
    assert sum(len(part) for part in fragments) >= 10, "too short to be told from other words"
    assert re.search(r"[^\n]*".join(fragments), messages()), message


def test_words_that_nobody_says_are_noticed() -> None:
    assert len(quoted()) > 50
    assert not re.search("the worker's Python is on holiday", messages())

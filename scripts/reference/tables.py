"""Tables of Markdown, and pages that say what they were made from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

NOTE = "<!-- Made by `make reference` from the sources: change those, not this page. -->"


def cell(text: str) -> str:
    """A text as one cell: on one line, with bars and brackets that Markdown leaves alone."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Rows of cells under titles."""
    lines = [f"| {' | '.join(titles)} |", f"|{'---|' * len(titles)}"]
    return "\n".join(lines + [f"| {' | '.join(row)} |" for row in rows])


def write_page(path: Path, text: str) -> None:
    """A page with the note of its origin."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{NOTE}\n\n{text}", "utf-8", newline="\n")

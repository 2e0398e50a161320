"""Takes what ``chona reproduce`` made into the repository: figures, pictures, and the tables of ``docs/results.md``.

python scripts/record_tables.py OUT [PROTOCOL]     (the folder that was given as --out)

PROTOCOL names another protocol than the one all tables were made with: ``full`` goes between the marks TABLE-full.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from PIL import Image

from chona_model.formats.atomic import atomic_path, write_bytes
from chona_model.reproduce.report import to_markdown
from chona_model.reproduce.tables import read_tables

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS, PICTURES = ROOT / "docs" / "results.md", ROOT / "benchmarks" / "results", ROOT / "docs" / "pictures"
COLOURS = 256
"""Of the pictures, so that they are small."""


def main(out: Path, protocol: str = "") -> None:
    """Every table of ``out`` that has a result."""
    ending = f"-{protocol}" if protocol else ""
    page = PAGE.read_text("utf-8")
    for name in read_tables():
        file = out / name / f"{name}.json"
        if not file.is_file():
            continue
        content = json.loads(file.read_text("utf-8"))
        write_bytes(RESULTS / f"reproduce-{name}{ending}.json", (json.dumps(content, indent=1) + "\n").encode())
        page = with_table(page, name + ending, table_of(content))
        picture = file.with_suffix(".png")
        if picture.is_file():
            with Image.open(picture) as image, atomic_path(PICTURES / f"reproduce-{name}{ending}.png") as temporary:
                image.quantize(COLOURS).save(temporary, format="PNG", optimize=True)
    write_bytes(PAGE, page.encode())


def table_of(content: dict) -> str:
    """A table's protocol and rows in Markdown, without its title."""
    return to_markdown(content).split("\n\n", 1)[1].strip()


def with_table(page: str, name: str, table: str) -> str:
    """The page with a table between its marks."""
    marks = f"<!-- {name} -->\n", f"<!-- /{name} -->"
    found = re.compile(re.escape(marks[0]) + ".*?" + re.escape(marks[1]), re.DOTALL)
    if not found.search(page):
        raise SystemExit(f"{PAGE} has no place for {name}; write the marks {marks[0].strip()} and {marks[1]} into it")
    return found.sub(lambda _: f"{marks[0]}{table}\n{marks[1]}", page)


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), *sys.argv[2:])

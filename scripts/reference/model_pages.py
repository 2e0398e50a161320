"""Writes the manual's page of the command `chona`: `python scripts/reference/model_pages.py FOLDER`."""

from __future__ import annotations

import sys
from pathlib import Path

from argument_pages import command_page
from tables import write_page

from chona_model.cli import COMMANDS
from chona_model.command_line import make_parser

WORDS = """The worker's command, without Blender. Long commands draw a bar on a terminal, or write JSON lines with
`--progress json`; they stop cleanly on Ctrl+C and keep what is finished. Exit codes: 0 done, 1 failed or cancelled,
2 wrong arguments or input, with one line on stderr that says what was given, what was expected and what to do."""


def main(folder: Path) -> None:
    """One page."""
    write_page(folder / "chona.md", command_page(make_parser(COMMANDS), "Command chona", WORDS, "chona"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

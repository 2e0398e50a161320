"""Every command that README and manual show is understood: options exist, values have the right kind."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from chona_model.arguments import UsageError, glue_frames
from chona_model.cli import COMMANDS
from chona_model.command_line import make_parser

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
IN_BLENDER = """
import json, sys
from chona_blender import command_line, commands
wrong = {}
for words in json.loads(sys.argv[1]):
    try:
        command_line.make_parser(commands.RUNS).parse_args(words)
    except command_line.WrongArguments as error:
        wrong[" ".join(words)] = str(error)
sys.stdout.write("\\n" + json.dumps(wrong) + "\\n")
"""


def shown() -> list[tuple[str, list[str]]]:
    """Page and words of each command line in a block of code; what an ellipsis leaves out is left out."""
    found = []
    for page in PAGES:
        for block in re.findall(r"^```\w*\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                if words and "…" not in line:
                    found.append((page.name, words))
    return found


def of_chona() -> list[tuple[str, list[str]]]:
    """Those of the worker's command, without its name."""
    return [(page, words[1:]) for page, words in shown() if words[0] in {"chona", ".venv/bin/chona"}]


def of_blender() -> list[list[str]]:
    """Those of `blender --command chona`, without all before."""
    return [words[words.index("chona") + 1 :] for _, words in shown() if words[0] == "blender" and "chona" in words]


@pytest.mark.parametrize(("page", "words"), of_chona(), ids=lambda value: " ".join(value)[:60])
def test_chona_understands(page: str, words: list[str]) -> None:
    with contextlib.redirect_stderr(io.StringIO()) as told:
        try:
            make_parser(COMMANDS).parse_args(glue_frames(words))
        except (SystemExit, UsageError) as error:
            pytest.fail(f"{page}: {error} {told.getvalue()}")


@pytest.mark.bpy
def test_blender_understands() -> None:
    python = os.environ.get("CHONA_BPY", "").split(os.pathsep)[0]
    if not python:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    command = [python, "-c", IN_BLENDER, json.dumps(of_blender())]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        command, env=environment | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True, timeout=120
    )
    assert len(of_blender()) >= 8
    assert json.loads(done.stdout.splitlines()[-1]) == {}


def test_there_are_commands_and_wrong_ones_are_noticed() -> None:
    assert len(of_chona()) >= 8
    with pytest.raises((SystemExit, UsageError)):
        make_parser(COMMANDS).parse_args(["bake", "--model", "a", "--shot", "b", "--out", "c", "--colour", "red"])

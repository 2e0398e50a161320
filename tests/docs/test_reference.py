"""docs/reference says what the sources say: `make reference` writes it again after a change."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COMMITTED = ROOT / "docs" / "reference"
SCRIPTS = ROOT / "scripts" / "reference"
ADDON_PAGES = ("panels.md", "operators.md", "blender-chona.md")


def write(python: str, script: str, folder: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "CHONA_"))}
    command = [python, str(SCRIPTS / script), str(folder)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]


def test_the_command_is_as_described(tmp_path: Path) -> None:
    write(sys.executable, "model_pages.py", tmp_path)
    assert (COMMITTED / "chona.md").read_text("utf-8") == (tmp_path / "chona.md").read_text("utf-8")


@pytest.mark.bpy
def test_the_add_on_is_as_described(tmp_path: Path) -> None:
    """In one version of Blender: which is the first that is given."""
    python = os.environ.get("CHONA_BPY", "").split(os.pathsep)[0]
    if not python:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    write(python, "addon_pages.py", tmp_path)
    for name in ADDON_PAGES:
        assert (COMMITTED / name).read_text("utf-8") == (tmp_path / name).read_text("utf-8"), name


def test_all_pages_are_made() -> None:
    """Nobody writes into the folder by hand."""
    assert {path.name for path in COMMITTED.iterdir()} == {"chona.md", *ADDON_PAGES}

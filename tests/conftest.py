"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import shlex
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

# A busy computer is no fault: pytest's own timeout ends what hangs.
settings.register_profile("chona", deadline=None)
settings.load_profile("chona")

# Commands keep a log in the home folder, which is the user's.
os.environ.setdefault("CHONA_LOGS", str(Path(tempfile.gettempdir()) / "chona-test-logs"))


@pytest.fixture(scope="session")
def hoibench() -> Path:
    """The synthetic benchmark capture: $CHONA_HOIBENCH, else ../shared/data/hoibench beside the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "hoibench"
    folder = Path(os.environ.get("CHONA_HOIBENCH", beside))
    if not (folder / "behave" / "sequences").is_dir():
        pytest.skip("the benchmark capture is absent; name its folder in CHONA_HOIBENCH")
    return folder


@pytest.fixture(scope="session")
def blender_launcher() -> list[str]:
    """The command that starts the real Blender: $CHONA_BLENDER, for example ``xvfb-run blender``."""
    command = shlex.split(os.environ.get("CHONA_BLENDER", ""))
    if not command or shutil.which(command[0]) is None:
        pytest.skip("$CHONA_BLENDER names no Blender")
    return command


@pytest.fixture
def often() -> Callable[[int, int], int]:
    """How many times a fault is tried: ``often(few, many)``; ``many`` with ``make test-faults``."""
    return lambda few, many: many if os.environ.get("CHONA_FAULTS") == "all" else few

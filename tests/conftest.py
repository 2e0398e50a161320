"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def hoibench() -> Path:
    """The synthetic benchmark capture: $CHONA_HOIBENCH, else ../shared/data/hoibench beside the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "hoibench"
    folder = Path(os.environ.get("CHONA_HOIBENCH", beside))
    if not (folder / "behave" / "sequences").is_dir():
        pytest.skip("the benchmark capture is absent; name its folder in CHONA_HOIBENCH")
    return folder

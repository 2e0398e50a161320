"""What kills, full disks, locks and little memory are tried on, made once."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

MODEL_TESTS = Path(__file__).parents[1] / "model"
sys.path[:0] = [str(MODEL_TESTS), str(MODEL_TESTS / "train")]


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    """``fault_scene.Scene``."""
    if sys.platform == "win32":
        pytest.skip("processes are forked")
    from fault_scene import make_scene

    made = make_scene(tmp_path_factory.mktemp("scene"))
    yield made
    made.nursery.close()

"""The add-on is switched on and off fifty times, also in the middle of a bake and of a live preview: nothing stays."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy, write_two_models

pytestmark = [pytest.mark.bpy, pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")]
FRAMES = 24
GROWTH = 2.0
"""Megabytes that the last thirty rounds may add; one round that left its classes would add more than this."""


@pytest.fixture(scope="module", params=bpy_pythons())
def answer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What happened in one version of Blender."""
    needs_worker(request.param)
    folder: Path = tmp_path_factory.mktemp("rounds")
    model, _ = write_two_models(folder)
    return run_bpy(request.param, "steady_rounds.py", model, sys.executable, folder, steady=True, seconds=550)


def test_work_was_under_way(answer: dict) -> None:
    count, handlers, drawing = answer["on"]
    assert count > 40 and len(handlers) >= 2 and "_draw" in drawing
    assert answer["working"] == [[1, True, False], [1, False, True], [1, True, False], [1, False, True]]


def test_nothing_is_left_after_any_round(answer: dict) -> None:
    clean = answer["clean"]
    assert (clean["classes"], clean["handlers"], clean["timers"], clean["drawing"]) == ([], [], [], [])
    assert (clean["threads"], clean["children"], clean["property"]) == ([], [], False)
    assert len(answer["rounds"]) == 10
    for found in answer["rounds"]:
        assert found == clean


def test_memory_and_files_stay(answer: dict) -> None:
    before, files, after, files_after = answer["held"]
    assert files_after == files
    assert after - before < GROWTH


def test_it_bakes_afterwards(answer: dict) -> None:
    result, names = answer["bake"]
    assert result == ["FINISHED"]
    assert set(names) == {*(f"walk_{number:04d}.exr" for number in range(1, FRAMES + 1)), "walk.shot.npz"}
    assert answer["last"] == ["DONE", ""]
    assert answer["current"] == [["FINISHED"], True], "an image that no editor shows is made for nobody"

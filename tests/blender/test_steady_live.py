"""The live preview says what is wrong when model, rig, camera or scene go, and goes on when they are back."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from operation_helpers import ROOT, bpy_pythons, needs_worker, run_bpy, write_two_models

pytestmark = [pytest.mark.bpy, pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")]


@pytest.fixture(scope="module", params=bpy_pythons()[:1])
def answer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What happened; ``test_live_preview.py`` goes through the preview in every version."""
    needs_worker(request.param)
    folder: Path = tmp_path_factory.mktemp("live")
    model, _ = write_two_models(folder)
    sys.path.insert(0, str(ROOT / "tests" / "faults"))
    from untrained_models import write_grid_model

    write_grid_model(folder / "stranger.safetensors", "Sub02", "box02")
    return run_bpy(request.param, "steady_live.py", model, sys.executable, folder, steady=True, seconds=550)


def check_told_and_mended(case: list, words: str) -> None:
    """A message in the view and in the panel, no picture meanwhile; then the picture, and no message."""
    told, alert, hidden, there, after = case[:5]
    assert words in told and (alert, hidden) == (True, True)
    assert (there, after) == (True, "")


def test_it_begins(answer: dict) -> None:
    assert answer["begins"] == [True, ""]


def test_rig_and_object_go(answer: dict) -> None:
    check_told_and_mended(answer["armature deleted"], "was deleted; undo that, or choose another under Rig")
    check_told_and_mended(answer["armature removed"], "No armature poses Sub01; press Create Rig, or choose")
    check_told_and_mended(answer["empty removed"], "Object 'box01' has no empty that moves it; choose one under Rig")


def test_camera_and_scene_go(answer: dict) -> None:
    check_told_and_mended(answer["camera removed"], "The scene has no camera: add one and make it active")
    assert answer["other scene"] == [True, "", 0], "nothing is asked for while nobody looks"
    assert answer["scene again"] == [True, ""]


def test_another_model_is_shown(answer: dict) -> None:
    there, error, change = answer["other model"]
    assert (there, error) == (True, "") and change > 0.05
    check_told_and_mended(answer["stranger"], "has no object 'box01'. It has: 'box02'. Choose one")
    assert answer["button"] == "The model has no person Sub01: choose one under Rig"


def test_a_damaged_or_missing_model_is_told(answer: dict) -> None:
    check_told_and_mended(answer["half"], "copy it again")
    check_told_and_mended(answer["removed"], "There is no model file")
    assert answer["removed"][5] == 0.0, "the same picture as in the beginning"


def test_buttons_are_on_again_when_the_model_is_back(answer: dict) -> None:
    off, why, on, nothing = answer["poll"]
    assert (off, on, nothing) == (False, True, "") and "There is no model file" in why


def test_the_panel_shows_the_file_that_is_there(answer: dict) -> None:
    assert answer["header"] == [["Sub01"], [1, True, "Sub02"], ["Sub02"], [1, True, "Sub01"]]
    assert answer["timer stays"], "a file that is opened must not end it"


def test_one_worker_and_in_the_end_none(answer: dict) -> None:
    assert answer["workers"] == 1
    assert answer["after a file"] == [False, []]
    assert answer["left"] == [[], [], [], []]

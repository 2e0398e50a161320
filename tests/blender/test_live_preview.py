"""The live preview in every Blender that is given, with a real worker and a small model; the window is not needed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy

pytestmark = pytest.mark.bpy
LISTENING = [
    "depsgraph_update_post _scene_changed",
    "frame_change_post _scene_changed",
    "undo_post _history_moved",
    "redo_post _history_moved",
    "load_pre _file_closes",
    "timer",
    "drawing",
]
AT_REST = ["load_pre _file_closes"]


@pytest.fixture(scope="module", params=bpy_pythons())
def answer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What happened in one version of Blender."""
    needs_worker(request.param)
    from tiny_models import trained

    from chona_model.grid_actor import GridActor
    from chona_model.model_store import save_actor

    model: Path = tmp_path_factory.mktemp("live") / "model.safetensors"
    save_actor(model, GridActor(trained()[1].model), "chona", {"preset": "fast"}, {"steps": 1})
    return run_bpy(request.param, "operation_live.py", model, sys.executable)


def test_a_pose_gets_a_draft_and_better_pictures_at_rest(answer: dict) -> None:
    assert answer["poll"] is True
    assert answer["toggled"] == ["FINISHED"]
    assert answer["while loading"] == "loading the model"
    assert answer["stages"] == ["draft", "preview", "final"]
    assert answer["sizes"] == [72, 96, 4]
    assert 0.01 < answer["covered"] < 0.9


def test_an_edit_without_a_key_changes_the_picture_and_stays(answer: dict) -> None:
    assert answer["noticed"]
    assert answer["change"] > 0.5
    assert answer["edit kept"] == 0.8
    assert answer["seconds to a draft"] < 5.0


def test_what_does_not_show_asks_for_nothing(answer: dict) -> None:
    assert answer["asked for nothing"] == 0


def test_the_newest_request_wins_and_a_refused_one_harms_nothing(answer: dict) -> None:
    assert answer["newest"] == 0
    assert "cannot read the shot" in answer["refused"]
    assert answer["alive after a refusal"]


def test_actors_of_several_models_are_shown(answer: dict) -> None:
    models, alone, both, same_worker = answer["two models"]
    assert models[0] == "" and models[1].endswith("other.safetensors")
    assert alone < 0.05 and both > 0.5 and same_worker
    assert answer["first switched off"] == "other.safetensors"  # the worker is another one, for the model that is left


def test_no_picture_stands_still_while_the_figure_moves(answer: dict) -> None:
    assert answer["stands still"] == [True, "waiting for the worker"]
    assert answer["goes on"] in {"draft", "preview"}
    quick, slow, slowest = answer["patience"][0::2]
    assert (quick, slow, slowest) == (0.5, 0.8, 2.0)
    assert answer["patience"][1::2] == pytest.approx([0.25, 0.25 * 0.5**0.5, 96 / 1024])


def test_a_dead_worker_is_told_and_replaced(answer: dict) -> None:
    for error, line, alert, hidden in answer["killed"]:
        assert error.startswith("The worker was ended by signal 9") and error.endswith("press Start Again")
        assert (line, alert, hidden) == (error, True, True)
    assert answer["waits"] == [True, 0, True]
    assert answer["restarted"] == ["", True, 1]


def test_another_model_file_gets_another_worker(answer: dict) -> None:
    assert answer["model changed"] == [True, False, 1]


def test_what_cannot_be_shown_is_told_in_the_view(answer: dict) -> None:
    told = answer["told"]
    assert "disabled in viewports" in told["hidden"][0]
    assert "shows its rest position" in told["rest"][0]
    for name in ("hidden", "rest"):
        assert told[name][1:] == [True, "", False], name
    assert told["deleted"][0].startswith("No armature poses Sub01") and told["deleted"][1]
    assert answer["without camera"] > 0.0


def test_pictures_fit_the_frame_and_the_time(answer: dict) -> None:
    assert answer["cropped"] == [1100.0, 560.0, 200.0, 120.0]
    draft, preview, final, fast, slow, slowest = answer["scales"]
    assert (draft, preview, final) == (0.25, 400 / 1024, 800 / 1024)
    assert fast == preview
    assert slow == pytest.approx(400 / 1024)  # a quarter of the time: half as wide
    assert slowest == draft


def test_nothing_is_left_behind(answer: dict) -> None:
    assert answer["before"] == AT_REST
    assert answer["on"] == LISTENING
    assert answer["after a file"] == [AT_REST, 0, False]
    assert answer["toggled 20 times"] == [AT_REST, 1, False]
    assert answer["left"] == 0
    assert answer["unregistered"] == [[], 0]
    assert answer["forgotten"]


def test_the_model_stays_loaded_between_previews(answer: dict) -> None:
    assert answer["warm"] == [True, True]


def test_a_worker_that_cannot_start_is_tried_once(answer: dict) -> None:
    error, same, processes = answer["broken model"]
    assert "model.safetensors" in error
    assert same
    assert processes == 0

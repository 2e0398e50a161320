"""What presets cost, in every Blender that is given: estimates, measurements and presets of one's own, real workers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy

pytestmark = pytest.mark.bpy
PRESETS = ["draft", "preview", "final", "exact"]


@pytest.fixture(scope="module", params=bpy_pythons())
def answer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What happened in one version of Blender."""
    needs_worker(request.param)
    from cli_files import write_capture
    from tiny_models import trained

    from chona_model.grid_actor import GridActor
    from chona_model.model_store import save_actor
    from chona_model.presets import save_preset
    from chona_model.settings import RENDER_PRESETS

    folder: Path = tmp_path_factory.mktemp("costs")
    save_actor(folder / "model.safetensors", GridActor(trained(120)[1].model), "chona", {}, {"steps": 120})
    write_capture(folder / "capture")
    own = folder / "presets"
    save_preset("my own", RENDER_PRESETS["draft"], own / "my own.json")
    paths = (folder / "model.safetensors", folder / "capture", sys.executable, folder)
    return run_bpy(request.param, "costs.py", *paths, environment={"CHONA_PRESETS": str(own)})


def test_times_read_as_one_says_them(answer: dict) -> None:
    assert answer["times"] == [
        "4 ms", "0.04 s", "0.1 s", "0.8 s", "9.9 s", "10 s", "12 s", "1 min 00 s", "3 min 20 s", "9 min 29 s",
        "10 min", "59 min", "1 h 00 min", "1 h 05 min", "25 h 00 min",
    ]  # fmt: skip
    assert answer["frame times"] == ["0.8 s", "10 s", "65 s", "599 s", "10 min"]
    assert answer["qualities"] == ["31.2 dB", "–", "–"]
    assert answer["sentences"] == [
        "final: 31.2 dB, 0.8 s a frame here; 250 frames ≈ 3 min 20 s",
        "final: 0.8 s a frame here; 250 frames ≈ 3 min 20 s",
    ]


def test_a_model_that_nobody_measured(answer: dict) -> None:
    assert answer["default"] == ["preview", 0.0]
    before, after = answer["unmeasured"], answer["unmeasured, estimated"]
    assert before["rows"] == {} and not before["note"]
    assert before["problem"].startswith("This model was not measured: chona trade")
    assert answer["estimated"] == ["FINISHED"]
    assert list(after["rows"])[:4] == PRESETS and not after["stale"]
    for quality, frame, total in (after["rows"][name] for name in PRESETS):
        assert quality == "–" and frame.endswith("s") and total.endswith(" s")
    assert answer["frames"] == 4 and "4 frames" in after["note"] and after["problem"]
    assert answer["shot is gone"]
    assert "press Measure" in answer["not shown yet"]


def test_an_estimate_is_cancelled(answer: dict) -> None:
    status, was_there, is_there, known = answer["cancelled"]
    assert (status, was_there, is_there, known) == ("CANCELLED", True, False, True)


def test_measuring_fills_the_table(answer: dict) -> None:
    assert answer["traded"] == ["FINISHED"]
    assert set(PRESETS) <= set(answer["trade"]) and all(value > 5 for value in answer["trade"].values())
    stale, fresh = answer["after trade"], answer["measured"]
    assert stale["stale"] and "the model" in stale["note"] and not stale["problem"]
    assert not fresh["stale"] and not fresh["problem"]
    for name in PRESETS:
        assert fresh["rows"][name][0] == stale["rows"][name][0] == f"{answer['trade'][name]:.1f} dB"
    assert answer["shown"] == ["FINISHED"] and answer["plot"][0] > 800


def test_an_estimate_gets_stale_and_comes_back(answer: dict) -> None:
    told = answer["stale"]
    words = {
        "end": "the frame range", "step": "the frame range", "own range": "the frame range",
        "size": "the size of the picture", "camera": "the camera", "lens": "the camera", "place": "the camera",
        "object": "the actors", "model": "the model", "shutter": "the blur", "focus": "the blur",
    }  # fmt: skip
    for name, part in words.items():
        stale, note, afterwards = told[name]
        assert stale and note == f"Out of date: estimated before {part} changed", name
        assert not afterwards, name
    for name in ("preset", "frame", "name", "samples of sharp frames"):
        assert told[name][0] is False, name


def test_the_command_prints_a_line_for_every_preset(answer: dict) -> None:
    assert answer["command"]["code"] == 0
    lines = answer["command"]["lines"]
    assert [line.partition(":")[0] for line in lines][:4] == PRESETS
    assert all(" dB, " in line and " a frame here; 3 frames ≈ " in line for line in lines[:4])
    code, words = answer["unknown preset"]
    assert code == 2 and "'nice'" in words and "draft, preview, final, exact, my own" in words
    assert answer["wrong bound"] == 2


def test_presets_of_ones_own(answer: dict) -> None:
    assert answer["presets"] == [*PRESETS, "my own"]
    assert answer["items"] == [[name, name.capitalize()] for name in PRESETS] + [["my own", "my own"]]
    assert answer["my own"][1] != "–"


def test_a_preset_that_is_gone_is_called_so(answer: dict) -> None:
    chosen, items = answer["missing"]
    assert chosen == "my own" and items[-1] == ["my own", "my own (missing)"]
    assert "'my own' is not on this computer" in answer["bake with missing"]
    assert "my own.json" in answer["bake with missing"] and "choose one under Bake" in answer["bake with missing"]
    assert answer["chosen anew"] == ["final", PRESETS]


def test_a_damaged_measurement_is_told_and_harms_nothing(answer: dict) -> None:
    assert len(answer["damaged"]) == 6
    for name, (absent, problem, shown, persons) in answer["damaged"].items():
        assert absent and persons == 1, name
        assert problem.startswith("What was measured of this model is damaged") and shown == problem, name
    assert answer["bake with damaged"] == ["FINISHED"]


def test_a_bake_with_an_error_bound_says_what_it_reached(answer: dict) -> None:
    error, bound, words = answer["bounded"]
    assert not error, error
    assert bound["asked"] == pytest.approx(0.02) and answer["bound"] == "0.02" and bound["refined"] > 0
    assert bound["unsettled"] == 0 and words == f"; every pixel within 0.02 ({bound['error']:.3g} reached)"
    assert answer["unsettled words"] == "; 3 of 727 pixels still change by more than 0.02, up to 0.0512"
    assert answer["no bound"] is False


def test_nothing_is_left_behind(answer: dict) -> None:
    assert answer["left"] == [0, 0, True]

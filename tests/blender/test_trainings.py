"""Trainings in Blender: one after the other, paused and resumed to the same model, with pictures. Real workers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from operation_helpers import ROOT, bpy_pythons, needs_worker, run_bpy

pytestmark = pytest.mark.bpy


@pytest.fixture(scope="module", params=bpy_pythons())
def ran(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """Where it happened, and what, in one version of Blender."""
    needs_worker(request.param)
    from cli_files import write_capture

    folder: Path = tmp_path_factory.mktemp("trainings")
    capture = write_capture(folder / "capture")
    small = ROOT / "tests" / "model" / "train" / "tiny_runs.py"
    return folder, run_bpy(request.param, "trainings.py", sys.executable, capture, folder, small)


@pytest.fixture
def answer(ran: tuple[Path, dict]) -> dict:
    return ran[1]


def tensors_of(model: Path) -> bytes:
    """A model file without its header, which holds the seconds."""
    content = model.read_bytes()
    return content[8 + int.from_bytes(content[:8], "little") :]


def test_the_list_is_an_order(answer: dict) -> None:
    assert answer["nothing"] == [False, False, []]
    names = ["one", "two", "four", "three"]
    assert answer["moved"] == [[name, "WAITING"] for name in names]
    assert answer["cancelled"][2] == ["four", "CANCELLED"]
    assert "is waiting already; choose another result folder" in answer["twice"]
    assert "nowhere" in answer["no data"] and "under Train" in answer["no data"]


def test_a_pause_is_a_checkpoint_and_holds_the_queue(answer: dict) -> None:
    assert answer["run"] == ["FINISHED"]
    paused = answer["paused"]
    assert paused["states"] == [["one", "PAUSED"], ["two", "WAITING"], ["four", "CANCELLED"]]
    assert 0.0 < paused["share"] < 1.0 and paused["next"] and "was paused" in paused["words"]
    assert {"checkpoint.safetensors", "model.safetensors", "preview.png"} <= set(paused["files"])
    assert "stop" not in paused["files"]


def test_resumed_in_another_session_is_the_same_model(ran: tuple[Path, dict]) -> None:
    """``one`` was paused and its file closed; ``two`` was trained at one go, with the same settings."""
    folder, answer = ran
    assert answer["other file"] == [] and answer["opened"] == answer["paused"]["states"]
    assert answer["resumed"] == ["FINISHED"]
    assert answer["done"] == [["one", "DONE"], ["two", "DONE"], ["four", "CANCELLED"]]
    one, two = (folder / name / "model.safetensors" for name in ("one", "two"))
    assert tensors_of(one) == tensors_of(two)
    assert one.stat().st_mtime < two.stat().st_mtime, "the one that goes on comes first"
    assert not (folder / "four" / "model.safetensors").exists() and not answer["again"]


def test_the_model_is_used(ran: tuple[Path, dict]) -> None:
    folder, answer = ran
    assert answer["actor"] == str(folder / "one" / "model.safetensors"), "a scene without an actor gets one"
    assert answer["use before"] and answer["used"] == [["FINISHED"], str(folder / "two" / "model.safetensors")]


def test_blender_quits_with_a_checkpoint(answer: dict) -> None:
    assert answer["closed"] == ["PAUSED", ["closed", "PAUSED"], True, "pause it under Train"]


def test_undo_leaves_the_list_alone(answer: dict) -> None:
    minutes, states, words = answer["undone"]
    assert minutes == 10.0, "the setting was undone"
    assert states == answer["done"] and words == "in the list"


def test_saved_lists(answer: dict) -> None:
    assert answer["was running"][1] == ["two", "PAUSED"]
    assert answer["damaged"] == []


def test_persons_and_objects_are_added_to_a_model(ran: tuple[Path, dict]) -> None:
    from chona_model.formats.model_file import read_header

    folder, answer = ran
    assert "there is no model" in answer["no base"] and "choose one under Add To" in answer["no base"]
    assert "write the names under Who" in answer["nobody"]
    assert answer["added"] == [["FINISHED"], "DONE"]
    header = read_header(folder / "added" / "model.safetensors")
    assert list(header.persons) == ["Sub01", "Ann"] and list(header.objects) == ["box01", "Crate"]
    one, added = ((folder / name / "model.safetensors").read_bytes() for name in ("one", "added"))
    assert len(added) > 1.5 * len(one)


def test_the_picture_is_there(answer: dict) -> None:
    shape, contrast = answer["picture"]
    assert shape == [360, 360, 3] and contrast > 0.5


def test_data_are_described_and_drawn(ran: tuple[Path, dict]) -> None:
    folder, answer = ran
    headline, warnings, sound, index, name, joints = answer["found"]
    assert answer["checked"] == ["FINISHED"] and headline == "Blender capture, 1 sequence, 1 person, 1 object, 4 views"
    assert (warnings, sound, index, name) == ([], True, 0, "Date01_Sub01_box01") and joints > 0.9
    shape, contrast, there = answer["sheet"]
    assert shape[0] == shape[1] and contrast > 0.5 and there
    assert answer["opened sheet"] == [["FINISHED"], True] and answer["next sheet"] == ["FINISHED"]
    assert answer["command"] == 0 and (folder / "sheets" / "Date01_Sub01_box01.png").is_file()
    assert answer["bad command"] == 2
    assert answer["gone"], "pictures in the temporary folder go with the add-on"

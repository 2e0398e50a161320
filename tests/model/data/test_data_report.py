"""What ``chona check-data`` says of a folder of every layout: fields, words, pictures and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_files import write_capture
from PIL import Image
from test_scans import write_co3d, write_transforms
from test_zju_mocap import subject  # noqa: F401 - a fixture

from chona_model.cli import main
from chona_model.data.checks import SHEET_COLUMNS, TILE_WIDTH


def check(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, list[dict], str]:
    """Exit code, events, and what went to stderr."""
    code = main(["check-data", *map(str, words), "--progress", "json"])
    said = capsys.readouterr()
    return code, [json.loads(line) for line in said.out.splitlines()], said.err


def brief(capsys: pytest.CaptureFixture[str], folder: Path) -> dict:
    """The result of a look that opens no image."""
    code, events, _ = check(capsys, folder, "--brief")
    assert code == 0 and events[-1]["event"] == "result"
    assert [each["checked"] for each in events[-1]["sequences"]] == [0] * len(events[-1]["sequences"])
    return events[-1]


def test_blender_captures(tmp_path: Path, capsys) -> None:
    said = brief(capsys, write_capture(tmp_path / "capture"))
    assert said["format"] == "blender"
    assert said["headline"] == "Blender capture, 1 sequence, 1 person, 1 object, 4 views"


def test_behave(tiny_behave: Path, capsys) -> None:
    said = brief(capsys, tiny_behave)
    assert said["format"] == "behave" and said["headline"].startswith("BEHAVE, 1 sequence, 1 person, 1 object, ")
    assert said["persons"] == ["Sub01"] and said["objects"] == ["crate"]


def test_zju_mocap(subject: Path, capsys) -> None:  # noqa: F811
    said = brief(capsys, subject)
    assert said["format"] == "zju_mocap" and said["headline"] == "ZJU-MoCap, 1 sequence, 1 person, 4 views"


def test_co3d(tmp_path: Path, capsys) -> None:
    said = brief(capsys, write_co3d(tmp_path / "co3d"))
    assert said["format"] == "co3d" and said["headline"].startswith("CO3D, 1 sequence, 1 object, ")


def test_transforms(tmp_path: Path, capsys) -> None:
    said = brief(capsys, write_transforms(tmp_path / "scan"))
    assert said["format"] == "transforms" and said["headline"].startswith("transforms.json, 1 sequence, 1 object, ")


def test_an_unknown_folder_is_an_event(tmp_path: Path, capsys) -> None:
    code, events, words = check(capsys, tmp_path)
    assert code == 2 and events[-1]["event"] == "error" and "no capture of a known layout" in events[-1]["message"]
    assert "no capture of a known layout" in words


def test_pictures_and_progress(tmp_path: Path, capsys) -> None:
    capture = write_capture(tmp_path / "capture", frames=3, cameras=4)
    code, events, _ = check(capsys, capture, "--out", tmp_path / "sheets", "--json", tmp_path / "report.json")
    assert code == 0 and [event["event"] for event in events] == ["start", "progress", "result"]
    (sequence,) = events[-1]["sequences"]
    assert events[-1]["sound"] and sequence["checked"] == 9 and sequence["joints_inside"] > 0.9
    with Image.open(sequence["sheet"]) as sheet:
        assert sheet.size == (SHEET_COLUMNS * TILE_WIDTH, 3 * TILE_WIDTH * 24 // 32)
    assert sorted(path.name for path in (tmp_path / "sheets").iterdir()) == [f"{sequence['name']}.png"]
    report = json.loads((tmp_path / "report.json").read_text("utf-8"))
    assert report == {key: value for key, value in events[-1].items() if key not in {"event", "job", "sound"}}


def test_damaged_data_are_told_and_still_described(tmp_path: Path, capsys) -> None:
    capture = write_capture(tmp_path / "capture")
    image = next((capture / "sequences").rglob("*.color.png"))
    image.write_bytes(image.read_bytes()[:-100])
    code, events, _ = check(capsys, capture)
    assert code == 1 and events[-1]["event"] == "result" and not events[-1]["sound"]
    assert image.name in events[-1]["warnings"][0] and events[-1]["headline"].startswith("Blender capture")


def test_brief_draws_nothing(tmp_path: Path, capsys) -> None:
    code, events, _ = check(capsys, write_capture(tmp_path / "capture"), "--brief", "--out", tmp_path / "sheets")
    assert code == 2 and "--brief" in events[-1]["message"] and "--out" in events[-1]["message"]

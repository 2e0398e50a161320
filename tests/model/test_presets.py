"""A user's presets: written, found by name, and refused where they are no settings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from chona_model.presets import every_preset, find_preset, presets_folder, save_preset, user_presets
from chona_model.settings import PRESETS, RENDER_PRESETS, ExactSettings, InverseSettings, RenderSettings, SettingsError

MINE = replace(
    RENDER_PRESETS["final"], step=0.01, occupancy_cell=2, resolution=0.5, upsampling="guided",
    exact=ExactSettings(16, InverseSettings(2, predict=0.04), roots="grid"),
)  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CHONA_PRESETS", str(tmp_path / "presets"))
    return tmp_path / "presets"


def test_the_programs_presets_are_found_by_name() -> None:
    for name in PRESETS:
        assert find_preset(name) is RENDER_PRESETS[name]
        assert RENDER_PRESETS[name].preset == name


def test_a_preset_comes_back_as_it_was_saved(folder: Path, tmp_path: Path) -> None:
    path = save_preset("hair test 2", MINE)
    assert path.parent == folder == presets_folder()
    assert find_preset("hair test 2") == find_preset(str(path)) == replace(MINE, preset="hair test 2")
    assert user_presets() == ["hair test 2"]
    elsewhere = save_preset("mine", MINE, tmp_path / "elsewhere.json")
    assert find_preset(str(elsewhere)).preset == "mine"


def test_one_bad_file_does_not_hide_the_others(folder: Path) -> None:
    save_preset("mine", MINE)
    (folder / "broken.json").write_text("{")
    assert list(every_preset()) == [*PRESETS, "mine"]


def test_what_is_not_there_names_what_is() -> None:
    save_preset("quick", MINE)
    with pytest.raises(SettingsError, match=r"no preset 'slow'; expected one of draft, preview, final, exact, quick"):
        find_preset("slow")


@pytest.mark.parametrize("name", ["final", "", "../up", "a/b", ".hidden", "trailing.", "x" * 64])
def test_names_that_no_preset_may_have(name: str) -> None:
    with pytest.raises(SettingsError, match="comes with the program" if name == "final" else "cannot be called"):
        save_preset(name, MINE)
    assert user_presets() == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": -1}, "'step' is -1.0, expected a number from 0.0001 to 1"),
        ({"step": "fast"}, "Expected `float`, got `str` - at `\\$.step`"),
        ({"upsampling": "magic"}, "'upsampling' is 'magic', expected one of bilinear, guided"),
        ({"speed": 3}, "unknown field 'speed'"),
        ({"stop": None}, "no field 'stop'"),
        ({"exact": {"samples": 3}}, "no field 'exact.bounded'"),
    ],
)
def test_damaged_presets_say_what_is_wrong(tmp_path: Path, change: dict, message: str) -> None:
    path = save_preset("mine", MINE)
    content = json.loads(path.read_text())
    content["settings"] = {name: v for name, v in (content["settings"] | change).items() if v is not None}
    path.write_text(json.dumps(content))
    with pytest.raises(SettingsError, match=message):
        find_preset("mine")


@pytest.mark.parametrize("text", ["", "[]", '{"format": "chona-preset", "version": 2}', "\0", '{"format": "zip"}'])
def test_other_files_are_no_presets(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(SettingsError, match=r"no preset of version 1|cannot use the preset"):
        find_preset(str(path))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"step": float("nan")}, "'step' is nan"),
        ({"supersampling": 0}, "'supersampling' is 0, expected a number from 1 to 16"),
        ({"resolution": 2.0}, "'resolution' is 2.0, expected a number from 0.0625 to 1"),
        ({"precision": "int8"}, "'precision' is 'int8', expected one of float32, float64"),
    ],
)
def test_settings_are_checked_when_they_are_made(wrong: dict, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        RenderSettings(**{"preset": "x", "step": 0.01, "newton_steps": 4, "stop": 0.0, **wrong})
    with pytest.raises(SettingsError, match="needs its spacing"):
        ExactSettings(roots="grid")

"""Registration, the compositor's restoration and the commands' exit codes, in every Blender that is given."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from operation_helpers import bpy_pythons, run_bpy, write_header_only_model

pytestmark = pytest.mark.bpy
every_blender = pytest.mark.parametrize("python", bpy_pythons())

EXPECTED_WORDS = {
    "missing model": "There is no model file",
    "no model": "No model file is set",
    "other version": "model version 2",
    "unmapped bone": "'spine'",
    "missing empty": "crate",
    "no armature": "No armature poses Robin",
    "no camera": "no camera",
    "empty range": "10 to 9 is empty",
    "reversed frames": "9-3",
    "not frames": "one",
    "not writable": "cannot be written",
    "bad name": "a/b",
    "worker without torch": "torch",
    "worker missing": "does not exist",
    "worker is no Python": "does not start",
    "unknown option": "--colour",
    "unknown command": "fry",
    "no command": "command",
    "no frames to composite": "bake",
    "no layer to remove": "no layer",
    "no scene": "no scene",
    "object without empty": "no object 'none'",
    "unknown object": "sofa",
    "save without name": "--save FILE.blend",
    "no data": "data folder",
    "data missing": "no data folder",
    "check without torch": "torch",
}


@every_blender
def test_registration_leaves_nothing_behind(python: str) -> None:
    answer = run_bpy(python, "operation_register.py")
    assert answer["clean"] == []
    on, off = answer["rounds"][0::2], answer["rounds"][1::2]
    assert len(set(on)) == 1 and on[0] > 20
    assert set(off) == {0}
    assert {"CHONA_PT_failure", "CHONA_OT_copy_failure"} <= set(answer["after_failure"])
    assert not any("PT_bake" in trace or trace == "Scene.chona" for trace in answer["after_failure"])
    assert answer["after_failure_off"] == []


@every_blender
def test_every_operator_and_property_explains_itself(python: str) -> None:
    answer = run_bpy(python, "operation_register.py")
    assert len(answer["operators"]) >= 12
    always_possible = {"chona.copy_report", "chona.dismiss_error", "chona.refresh_presets"}
    for name, each in answer["operators"].items():
        assert len(each["tooltip"]) > 15, name
        assert each["untold"] == [], name
        assert each["poll"] or name in always_possible, name
    assert answer["untold"] == []


@every_blender
def test_removing_layers_restores_the_users_tree(python: str, tmp_path: Path) -> None:
    """Six shapes of trees, two layers, removed in both orders."""
    for name, number in (("walk", 4), ("zero", 0)):
        channels = {"CHONA.Combined": np.zeros((16, 32, 4), np.float16), "CHONA.Depth.Z": np.ones((16, 32), np.float32)}
        OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(tmp_path / f"{name}_{number:04d}.exr"))
    answer = run_bpy(python, "operation_restore.py", tmp_path)
    assert len(answer) == 12
    for shape, each in answer.items():
        assert each["same"], f"{shape}: {each['before']} became {each['after']}"
        assert sorted(each["names"]) == ["walk", "zero"], shape
        assert each["groups"] == ["CHONA walk", "CHONA zero"], shape


@every_blender
def test_wrong_input_has_a_message_and_exit_code_2(python: str, tmp_path: Path) -> None:
    model = write_header_only_model(tmp_path / "model.safetensors")
    other = write_header_only_model(tmp_path / "other.safetensors", version=2)
    answer = run_bpy(python, "operation_commands.py", model, other, sys.executable, tmp_path / "out")
    assert answer.pop("help")["code"] == 0
    assert answer.keys() == EXPECTED_WORDS.keys()
    for case, each in answer.items():
        assert each["code"] == 2, f"{case}: {each}"
        assert len(each["said"]) == 1, f"{case}: {each}"
        assert EXPECTED_WORDS[case] in each["said"][0], f"{case}: {each}"
    assert os.sep in answer["not writable"]["said"][0]


@every_blender
def test_capture_command_writes_a_finished_capture(python: str, tmp_path: Path) -> None:
    answer = run_bpy(python, "operation_capture.py", tmp_path / "capture")
    assert answer["codes"] == [0, 0, 2], answer
    assert answer["events"] >= 4 and "captured 0 frames, 2 were there" in answer["words"]
    description = json.loads((tmp_path / "capture" / "capture.json").read_text())
    assert list(description["persons"]) == ["Robin"] and list(description["objects"]) == ["crate"]
    frames = tmp_path / "capture" / "sequences" / "Robin_crate"
    assert len(list(frames.glob("000*/*.color.png"))) == 4

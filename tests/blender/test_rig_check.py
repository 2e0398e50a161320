"""Mapping, presets, Check and several actors through the add-on's own operators, in every Blender."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from operation_helpers import FIGURE, bpy_pythons, run_bpy, write_header_only_model
from scipy.spatial.transform import Rotation

from chona_model.skeleton import Skeleton, forward_kinematics
from chona_model.train.pose_summary import summarise

pytestmark = pytest.mark.bpy
NAMES = [name for name, _, _ in FIGURE]
PARENTS = [parent for _, parent, _ in FIGURE]


def write_model(path: Path) -> Path:
    """A model's header that knows forty training poses: small turns everywhere."""
    write_header_only_model(path)
    content = path.read_bytes()
    description = json.loads(json.loads(content[8:])["__metadata__"]["chona"])
    random = np.random.default_rng(0)
    joints = np.array([joint for _, _, joint in FIGURE])
    turns = Rotation.from_rotvec(random.normal(0, 0.15, (40 * len(NAMES), 3))).as_matrix().reshape(40, -1, 3, 3)
    turns[0] = np.eye(3)
    skeleton = Skeleton(tuple(NAMES), tuple(PARENTS))
    poses = np.stack([forward_kinematics(skeleton, joints, each, np.zeros(3)) for each in turns])
    description["training"] = {"poses_seen": summarise(NAMES, PARENTS, poses)}
    header = json.dumps({"__metadata__": {"chona": json.dumps(description)}}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header)
    return path


@pytest.fixture(scope="module", params=bpy_pythons())
def found(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What the script did."""
    folder = tmp_path_factory.mktemp("check")
    model = write_model(folder / "model.safetensors")
    silent = write_header_only_model(folder / "silent.safetensors")
    home = {"BLENDER_USER_RESOURCES": str(folder / "home")}
    return run_bpy(request.param, "rig_check.py", model, silent, environment=home)


def test_the_table_says_what_was_recognised(found: dict) -> None:
    case = found["mapping"]
    assert case["family"] == "Mixamo: 16 of 16 bones"
    assert case["rows"]["left_shoulder"] == ["", "LeftArm", "FOUND"]
    assert case["rows"]["right_ankle"] == ["", "RightFoot", "FOUND"]
    assert all(state == "FOUND" for _, _, state in case["rows"].values())


def test_bones_are_picked_saved_as_a_preset_and_loaded(found: dict) -> None:
    case = found["mapping"]
    assert case["picked"] == ["Neck", "FOLLOWS"]
    assert case["saved"] == ["FINISHED"]
    assert case["recognised again"] == ["Head", "LeftHand"]
    assert case["loaded"] == ["Neck", "FOLLOWS", "LeftUpLeg"]
    assert case["removed"] == ["FINISHED"] and case["left"] == ""


def test_missing_bones_are_told_by_the_table_and_by_check(found: dict) -> None:
    family, state, selected = found["mapping"]["missing"]
    assert family.endswith("1 missing") and state == "MISSING" and selected == "left_knee"
    assert ["ERROR", "", None, "Nothing moves 'left_knee': choose a bone for it"] in found["mapping"]["unmapped"]


def test_check_tells_bone_and_frame(found: dict) -> None:
    assert found["wrong"]["good"] == []
    told = {bone: (kind, frame, words) for kind, bone, frame, words in reversed(found["wrong"]["wrong"])}
    kind, frame, words = told["LeftForeArm"]
    assert (kind, frame) == ("ERROR", 2) and "sheared or stretched unevenly by 30 % in frame 2" in words
    kind, _, words = told["RightForeArm"]
    assert kind == "WARNING" and "scaled to 1.05 in all frames" in words
    kind, frame, words = told["RightLeg"]
    assert (kind, frame) == ("ERROR", 3) and "zero scale in frame 3" in words
    assert "LeftHand" not in told, "a hand that only inherits its arm's shear is not told"
    kinds = [kind for kind, *_ in found["wrong"]["wrong"]]
    assert kinds == sorted(kinds, key=["ERROR", "WARNING", "INFO"].index)
    assert found["wrong"]["rows"] == [words for *_, words in found["wrong"]["wrong"]]


def test_a_finding_takes_the_animator_to_its_bone_and_frame(found: dict) -> None:
    assert found["wrong"]["shown"] == [2, "POSE", ["LeftForeArm"], "LeftForeArm"]


def test_the_strip_is_green_in_training_and_red_far_from_it(found: dict) -> None:
    case = found["strips"]
    assert case["level"][:2] == [0.0, 0.0] and case["level"][2] == 1.0
    assert case["words"] == "frame 3 outside the training poses"
    ((kind, bone, frame, words),) = case["told"]
    assert (kind, bone, frame) == ("WARNING", "LeftLeg", 3) and "further than in any pose the model has seen" in words
    degrees = float(words.split(" turned ")[1].split("°")[0])
    assert np.degrees(2.4) - 60.0 < degrees < np.degrees(2.4) - 10.0
    green, red = case["paint"][0], case["paint"][2]
    assert green[1] > green[0] and red[0] > red[1]
    assert case["corners"] == [18, 18, 0.5, 3.5]


def test_models_without_a_record_say_so(found: dict) -> None:
    assert found["strips"]["silent"] == ["the model has no record of its training poses", 0]


def test_several_actors_share_a_shot(found: dict) -> None:
    case = found["several"]
    (one, two, three) = case["names"]
    assert one[1:] == ["Robin", ["crate"], False] and two[1] == "Robin" and one[0] != two[0]
    assert three == ["objects", None, ["crate"], True]
    np.testing.assert_allclose(case["apart"], [1.5, 0.0, 0.0], atol=1e-5)
    assert case["fewer"] == 2 and case["left"] == 2 and case["same armature"]


def test_buttons_say_why_they_are_off(found: dict) -> None:
    polls = found["polls"]
    assert "Choose a model file first" in polls["map_rig"] and "Choose a model file first" in polls["object_add"]
    assert "Press Check first" in polls["show_finding"]
    assert "Choose a model file and an armature first" in polls["check"]
    assert polls["first model"] == [1, True, ""]

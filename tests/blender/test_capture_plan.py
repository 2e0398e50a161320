"""Before a capture: where cameras stand, what is refused, what it will take; and a capture that is interrupted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from operation_helpers import ROOT, SCRIPTS, bpy_pythons, run_bpy
from PIL import Image

pytestmark = pytest.mark.bpy
CAMERAS, FRAMES = 3, 4
"""Of ``tiny_character.OPTIONS``."""


@pytest.fixture(scope="module", params=bpy_pythons())
def answer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What happened in one version of Blender."""
    return run_bpy(request.param, "capture_plan.py", tmp_path_factory.mktemp("plan"))


def test_one_ring_is_a_circle_that_looks_inwards(answer: dict) -> None:
    poses, middle = np.array(answer["plain"]), np.array([1.0, 2.0, 0.5])
    # The figure faces −y: the first camera is before it, the second on its left, looking from +x.
    expected = middle + 3.0 * np.array([[0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    assert poses[:, :3, 3] == pytest.approx(expected, abs=1e-12)
    assert poses[:, :3, 2] == pytest.approx((expected - middle) / 3.0), "a camera looks along its −z"
    assert poses[:, :3, 1] == pytest.approx(np.array([[0, 0, 1]] * 4)), "upright"
    assert np.linalg.det(poses[:, :3, :3]) == pytest.approx(np.ones(4))


def test_several_rings_stand_above_each_other_in_the_gaps(answer: dict) -> None:
    places = np.array(answer["rings"]).reshape(3, 4, 3) - np.array([1.0, 2.0, 0.5])
    for level, ring in enumerate(places):
        raised = np.array([0.0, 0.3, 0.0, 0.3])
        turn = -np.pi / 2 + np.arange(4) * np.pi / 2 + (np.pi / 4 if level == 1 else 0.0)
        flat = 3.0 * np.cos(raised)
        height = 3.0 * np.sin(raised) + 0.2 + 0.7 * (level - 1)
        expected = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
        assert ring == pytest.approx(expected, abs=1e-9)


def test_a_fitted_radius_just_holds_a_ball(answer: dict) -> None:
    """The shorter side decides: half of 36 mm, times three quarters, over 40 mm."""
    narrow = 1.2 / np.sin(np.arctan(18.0 / 40.0 * 0.75))
    assert answer["fitted"] == pytest.approx([narrow, narrow, 1.2 / np.sin(np.arctan(18.0 / 40.0))])


def test_blender_sees_what_is_said_to_be_seen(answer: dict) -> None:
    for radius, short, agrees in answer["agrees"]:
        assert agrees
        assert (short == 0) == (radius == 0.0), "a fitted ring sees everything, these others do not"
    assert answer["left"] == 0


def test_cameras_are_drawn_where_they_will_stand(answer: dict) -> None:
    shown, words, problem = answer["shown"]
    assert shown == ["FINISHED"] and not problem and words.startswith("3 cameras at ") and "all see" in words
    whole, short, circles = answer["lines"]
    assert whole[0] == 3 * 11 and short[0] == 0 and circles == [96, 2, 3] and answer["eyes"] < 1e-9
    assert answer["cuts"].startswith("6 cameras at 2.00 m; ")
    assert answer["no frames"][1] and "range" in answer["no frames"][0]
    assert answer["hidden"] == [["FINISHED"], False, True], "the scene is as it was"


def test_a_ring_that_is_too_small_is_refused(answer: dict) -> None:
    assert answer["too near"].startswith("The character leaves the ring")
    assert "in frame" in answer["refused"] and "0.50 m" in answer["refused"] and "0 to have it" in answer["refused"]
    assert "range of the capture is empty" in answer["no frames"][2]


def test_a_character_without_a_mesh(answer: dict) -> None:
    assert "No mesh follows the armature 'Robin'" in answer["no mesh"] and "metarig" in answer["no mesh"]
    assert all("No mesh follows the armature 'Robin'" in words for words in answer["operators"])


def test_the_estimate_is_near_the_truth(answer: dict) -> None:
    images, cameras, finished, seconds, size = answer["estimate"]
    assert (images, cameras, finished) == (6 * 3, 3, 0) and answer["nothing written"]
    assert 0.5 < seconds < 2.0, "of the time it took"
    assert 0.8 < size < 1.2, "of the size it has"
    assert answer["all there"] == [0, 6, 0, 6] and answer["unchanged"] == [1, True]


def test_armatures_of_every_family_can_be_captured(answer: dict) -> None:
    assert {"rigify", "mixamo A-pose"} <= set(answer["families"])
    for name, case in answer["families"].items():
        assert case["bones"] >= 16 and not case["warnings"], name
        assert case["away"] == pytest.approx(case["drawn"], rel=0.02), f"{name}: drawn where they stand"
        assert 1.2 < case["height"] < 1.9, f"{name}: metres, whatever the armature's unit"


def command(python: str, folder: Path, *more: str) -> tuple[list[str], dict[str, str]]:
    variables = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    variables["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(SCRIPTS)])
    return [python, str(SCRIPTS / "capture_command.py"), "--capture-folder", str(folder), *more], variables


def files_of(folder: Path) -> dict[str, bytes]:
    """Contents by name; of images their pixels, beside which Blender notes how long it took."""
    found = {}
    for path in folder.rglob("*"):
        if path.suffix == ".png":
            with Image.open(path) as picture:
                found[str(path.relative_to(folder))] = np.asarray(picture).tobytes()
        elif path.is_file():
            found[str(path.relative_to(folder))] = path.read_bytes()
    return found


@pytest.mark.parametrize("python", bpy_pythons())
def test_an_interrupted_capture_goes_on_to_the_same_files(python: str, tmp_path: Path) -> None:
    if not python:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    words, variables = command(python, tmp_path / "broken")
    process = subprocess.Popen(words, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    told = []
    for line in process.stdout:
        if line.startswith('{"event": "progress"'):
            told.append(json.loads(line))
        if len(told) == CAMERAS + 1:  # in the middle of the second frame
            process.send_signal(signal.SIGTERM)
            break
    rest, said = process.communicate(timeout=120)
    assert process.returncode == 1 and '"cancelled"' in rest, said
    assert "whole frames are kept" in said
    assert told[0]["total"] == CAMERAS * FRAMES and told[-1]["eta"] > 0
    sequence = tmp_path / "broken" / "sequences" / "Robin_crate"
    frames = sorted(path.name for path in sequence.iterdir() if path.is_dir())
    assert frames == ["0001"] and len(list((sequence / "0001").iterdir())) == 3 * CAMERAS
    assert not (tmp_path / "broken" / "capture.json").exists()
    (sequence / ".0002.partial").mkdir()  # as a process leaves it that was killed
    for folder in ("broken", "whole"):
        words, variables = command(python, tmp_path / folder)
        done = subprocess.run(words, env=variables, capture_output=True, text=True, check=False, timeout=240)
        assert done.returncode == 0, done.stderr
        result = json.loads([line for line in done.stdout.splitlines() if line.startswith("{")][-1])
        assert (result["written"], result["skipped"]) == ((3, 1) if folder == "broken" else (4, 0))
    broken, whole = files_of(tmp_path / "broken"), files_of(tmp_path / "whole")
    assert broken.keys() == whole.keys()
    assert [name for name in whole if broken[name] != whole[name] and not name.endswith(".npz")] == []

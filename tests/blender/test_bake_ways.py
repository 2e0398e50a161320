"""Where a bake goes, which frames it renders and what becomes of those that are there, in every Blender given."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import OpenEXR
import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy

pytestmark = pytest.mark.bpy


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("torch")
    sys.path.insert(0, str(Path(__file__).parents[1] / "model"))
    from tiny_models import trained

    from chona_model.grid_actor import GridActor
    from chona_model.model_store import save_actor

    path: Path = tmp_path_factory.mktemp("bake") / "model.safetensors"
    save_actor(path, GridActor(trained()[1].model), "chona", {"preset": "fast"}, {"steps": 1})
    return path


@pytest.fixture(scope="module", params=bpy_pythons())
def found(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, model: Path) -> dict:
    """What happened in one version of Blender, and the folder it happened in."""
    needs_worker(request.param)
    folder = tmp_path_factory.mktemp("ways")
    return run_bpy(request.param, "bake_ways.py", model, sys.executable, folder) | {"folder": folder}


def test_frames_go_beside_the_scenes_own_output(found: dict) -> None:
    unsaved = Path(tempfile.gettempdir()) / "chona_unsaved"
    names = ["walk", "shot", "sh010", "a", "shot"]
    for root, places in ((unsaved, found["places"][:5]), (found["folder"], found["places"][5:])):
        folders = [root / "render" / "walk_chona", root / "render" / "chona"]
        folders += [Path("/renders") / name for name in ("sh010_chona", "a_chona", "chona")]
        assert [each[0] for each in places] == [str(each) for each in folders]
        assert [each[1] for each in places] == names
        assert [each[2] for each in places] == [root == unsaved] * 2 + [False] * 3
    for words, refused in found["bad names"]:
        assert "cannot be part of a file name" in words and refused
    assert "no output folder" in found["no folder"]


def test_frames_are_chosen_in_every_way(found: dict) -> None:
    ranges = found["ranges"]
    assert ranges["SCENE"] == [3, 5, 7, 9]
    assert ranges["CUSTOM"] == [-2, 0, 2]
    assert ranges["CURRENT"] == [7]
    assert ranges["markers (0,)"] == [4, 6]  # to the frame before the next marker, with the scene's step
    assert ranges["markers (0, 1)"] == [4, 6, 8]
    assert ranges["markers (2,)"] == [12]  # behind the scene's end
    assert "no marker of the timeline is selected" in ranges["no marker"]
    assert "3 to 2 is empty" in ranges["empty"]


def test_a_button_that_is_off_says_why(found: dict) -> None:
    told = found["obstacles"]
    assert found["empty scene"] == "Choose a model file first"
    assert told.pop("nothing yet") == told.pop("nothing again") == told.pop("camera by marker") == ""
    expected = {
        "no armature": "choose an armature for Sub01", "no empty": "moves the object box01",
        "no model": "choose a model file", "model gone": "no model file", "nobody": "Every actor is switched off",
        "no camera": "no camera", "panoramic": "lens type",
    }  # fmt: skip
    assert told.keys() == expected.keys()
    for name, words in expected.items():
        assert words.lower() in told[name].lower(), name


def test_existing_frames_are_updated_kept_or_overwritten(found: dict) -> None:
    written = found["written"]
    assert written["at first"] == ["0001", "0002", "0003"]
    assert found["there"] == [1, 2, 3]
    assert written["keep"] == ["0002"]  # the third is out of date
    assert written["update"] == ["0003"]
    assert written["command"] == 0
    assert written["overwrite"] == ["0001", "0002", "0003"]


def test_the_current_frame_alone_inside_the_border(found: dict) -> None:
    assert found["written"]["current"] == ["0002"]
    assert found["shot stays"]
    assert found["left"] == ["walk.shot.npz", "walk_0001.exr", "walk_0002.exr", "walk_0003.exr"]
    with OpenEXR.File(str(found["folder"] / "frames" / "walk_0002.exr")) as file:
        assert file.channels()["CHONA.Combined"].pixels.shape == (16, 36, 4)
        shown = file.channels()["CHONA.Combined"].pixels[..., 3] > 0.5
    assert shown[:, :18].any() and shown[:, 18:].any()  # one actor on the left, the other model's on the right


def test_every_frame_has_its_markers_camera(found: dict) -> None:
    assert found["camera x"] == pytest.approx([0.0, 1.0, 1.0])
    wide, keyed, last = found["camera lens"]
    assert wide == pytest.approx(48 * 50 / 36, rel=1e-5) and last == pytest.approx(48 * 70 / 36, rel=1e-5)
    assert wide < keyed < last
    assert found["camera centre"] == pytest.approx([24.0, 24.0 - 0.25 * 48, 24.0 - 0.25 * 48])

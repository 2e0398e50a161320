"""BEHAVE's reader on a tiny capture: conventions, gaps and refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from chona_model.data.behave import UPRIGHT, read_behave
from chona_model.data.dataset import DatasetError
from chona_model.data.images import load_pixels
from chona_model.data.lens import Lens

SEQUENCE = "Date01_Sub01_crate_lift"


def test_names_and_views_are_those_of_the_folder(tiny_behave: Path) -> None:
    dataset = read_behave(tiny_behave)
    assert list(dataset.persons) == ["Sub01"]
    assert list(dataset.objects) == ["crate"]
    assert [view.label for view in dataset.views] == [
        f"{SEQUENCE}_{frame}_k{kinect}" for frame in ("t0003.000", "t0004.000") for kinect in (0, 1)
    ]
    assert not dataset.gaps


def test_the_principal_point_moves_by_half_a_pixel(tiny_behave: Path) -> None:
    camera = read_behave(tiny_behave).views[1].camera
    # A point on BEHAVE's optical axis lies at (cx, cy) with centres at integers, so at +0.5 here.
    pixel, depth = camera.project(np.array([0.0, 2.0, 0.0]))
    assert pixel == pytest.approx([15.5 + 0.5, 11.5 + 0.5])
    assert depth == pytest.approx(2.0)
    assert camera.intrinsics[0, 0] == 40.0


def test_the_object_frame_is_its_template_mean_under_the_fit(tiny_behave: Path) -> None:
    dataset = read_behave(tiny_behave)
    frame = dataset.views[0].pose.world_from_object[0]
    assert frame[:3, 3] == pytest.approx([0.1, 2.5, -0.2])
    assert frame[:3, :3] @ [1.0, 0.0, 0.0] == pytest.approx([0.0, -1.0, 0.0])
    assert dataset.objects["crate"].lower == pytest.approx([-0.1, -0.2, -0.3])
    assert dataset.objects["crate"].upper == pytest.approx([0.1, 0.2, 0.3])


def test_rest_pose_frames_are_translations_to_the_joints(tiny_behave: Path) -> None:
    dataset = read_behave(tiny_behave)
    frames, joints = dataset.views[0].pose.world_from_bone, dataset.persons["Sub01"].rest_joints
    assert frames[:, :3, :3] == pytest.approx(np.broadcast_to(UPRIGHT[:3, :3], (24, 3, 3)))
    assert frames[:, :3, 3] == pytest.approx((joints + np.array([0.0, 0.0, 2.0])) @ UPRIGHT[:3, :3].T)
    assert UPRIGHT[:3, :3] @ [0.0, -1.0, 0.0] == pytest.approx([0.0, 0.0, 1.0])


def test_single_frames_can_be_chosen(tiny_behave: Path) -> None:
    dataset = read_behave(tiny_behave, [f"{SEQUENCE}/t0004.000", f"{SEQUENCE}/t0099.000"])
    assert {view.frame for view in dataset.views} == {"t0004.000"}
    assert dataset.gaps == {"frame": 1}


def test_missing_parts_are_counted_and_their_views_skipped(tiny_behave: Path) -> None:
    sequence = tiny_behave / "sequences" / SEQUENCE
    (sequence / "t0003.000" / "k0.person_mask.jpg").unlink()
    (sequence / "t0003.000" / "k1.obj_rend_mask.jpg").unlink()
    (sequence / "t0004.000" / "k1.color.jpg").unlink()
    dataset = read_behave(tiny_behave)
    assert [view.label for view in dataset.views] == [f"{SEQUENCE}_t0004.000_k0"]
    assert dataset.gaps == {"person mask": 1, "object mask": 1, "image": 1}


@pytest.mark.parametrize("part", ["person/fit02/person_fit.pkl", "crate/fit01/crate_fit.pkl"])
def test_a_frame_without_a_fit_is_skipped(tiny_behave: Path, part: str) -> None:
    (tiny_behave / "sequences" / SEQUENCE / "t0003.000" / part).unlink()
    dataset = read_behave(tiny_behave)
    assert {view.frame for view in dataset.views} == {"t0004.000"}
    assert dataset.gaps == {"person fit" if "person" in part else "object fit": 1}


def test_a_fit_with_a_nan_is_skipped(tiny_behave: Path, write_fit: Callable[..., None]) -> None:
    write_fit(tiny_behave / "sequences" / SEQUENCE / "t0003.000", np.full(156, np.nan))
    dataset = read_behave(tiny_behave)
    assert {view.frame for view in dataset.views} == {"t0004.000"}
    assert dataset.gaps == {"person fit (not finite)": 1}


def test_an_object_without_template_gets_the_default_box(tiny_behave: Path) -> None:
    (tiny_behave / "objects" / "crate" / "crate_f1000.ply").unlink()
    dataset = read_behave(tiny_behave)
    assert dataset.objects["crate"].upper == pytest.approx([0.6, 0.6, 0.6])
    assert dataset.gaps == {"object template": 1}


def test_a_distorting_lens_is_read(tiny_behave: Path) -> None:
    path = tiny_behave / "calibs" / "intrinsics" / "0" / "calibration.json"
    content = json.loads(path.read_text())
    content["color"]["opencv"][4] = 0.3
    path.write_text(json.dumps(content))
    lenses = {view.camera_name: view.lens for view in read_behave(tiny_behave).views}
    assert lenses == {"k0": Lens(k1=0.3), "k1": None}


def test_a_missing_calibration_is_named(tiny_behave: Path) -> None:
    (tiny_behave / "calibs" / "Date01" / "config" / "1" / "config.json").unlink()
    with pytest.raises(DatasetError, match=r"no calibration 1/config\.json.*copy BEHAVE's folder 'calibs'"):
        read_behave(tiny_behave)


def test_a_scaled_camera_rotation_is_refused(tiny_behave: Path) -> None:
    path = tiny_behave / "calibs" / "Date01" / "config" / "1" / "config.json"
    path.write_text(json.dumps({"rotation": [2, 0, 0, 0, 1, 0, 0, 0, 1], "translation": [0, 0, 0]}))
    with pytest.raises(DatasetError, match="the rotation is not one"):
        read_behave(tiny_behave)


def test_a_missing_body_model_tells_where_to_put_it(tiny_behave: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CHONA_BODY_MODELS", raising=False)
    (tiny_behave / "smplh" / "SMPL_male.npz").unlink()
    with pytest.raises(DatasetError, match=r"--body-model DIR or \$CHONA_BODY_MODELS, or put it into a folder 'smplh'"):
        read_behave(tiny_behave)


def test_the_body_model_may_be_named_by_argument_or_environment(
    tiny_behave: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tiny_behave / "smplh").rename(tmp_path / "elsewhere")
    assert read_behave(tiny_behave, None, tmp_path / "elsewhere").views
    monkeypatch.setenv("CHONA_BODY_MODELS", str(tmp_path / "elsewhere"))
    assert read_behave(tiny_behave).views


def test_an_unknown_sequence_lists_those_there_are(tiny_behave: Path) -> None:
    with pytest.raises(DatasetError, match=f"no sequence 'Date09_Sub01_crate'.*it has {SEQUENCE}"):
        read_behave(tiny_behave, ["Date09_Sub01_crate"])


def test_a_capture_without_fits_says_what_was_expected(tiny_behave: Path) -> None:
    for path in (tiny_behave / "sequences").glob("*/*/person/fit02/*.pkl"):
        path.unlink()
    with pytest.raises(DatasetError, match="missing: 2 x person fit"):
        read_behave(tiny_behave)


def test_a_truncated_fit_is_named(tiny_behave: Path) -> None:
    path = tiny_behave / "sequences" / SEQUENCE / "t0003.000" / "person" / "fit02" / "person_fit.pkl"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DatasetError, match=r"cannot read .*person_fit\.pkl.*copy the file again"):
        read_behave(tiny_behave)


def test_a_truncated_image_is_named(tiny_behave: Path) -> None:
    view = read_behave(tiny_behave).views[0]
    view.image.write_bytes(view.image.read_bytes()[:200])
    with pytest.raises(DatasetError, match=r"cannot read the image .*k0\.color\.jpg"):
        load_pixels(view)


def test_one_person_has_one_gender(tiny_behave: Path) -> None:
    other = tiny_behave / "sequences" / "Date01_Sub01_crate_sit"
    (tiny_behave / "sequences" / SEQUENCE / "t0004.000").rename(tiny_behave / "moved")
    other.mkdir()
    (tiny_behave / "moved").rename(other / "t0004.000")
    info = json.loads((tiny_behave / "sequences" / SEQUENCE / "info.json").read_text())
    (other / "info.json").write_text(json.dumps(info | {"gender": "female"}))
    (tiny_behave / "smplh" / "SMPL_female.npz").write_bytes((tiny_behave / "smplh" / "SMPL_male.npz").read_bytes())
    with pytest.raises(DatasetError, match="Sub01 is male in one sequence and female"):
        read_behave(tiny_behave)

"""ZJU-MoCap's reader: a tiny capture in its layout, and the benchmark's own meshes and masks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import write_body_model
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

from chona_model.data.body_model import read_body_model
from chona_model.data.dataset import DatasetError
from chona_model.data.images import load_pixels
from chona_model.data.lens import Lens
from chona_model.data.opener import guess_format, open_dataset
from chona_model.data.zju_mocap import read_zju_mocap
from chona_model.skeleton import canonical_to_world

TURNED = Rotation.from_euler("xyz", [0.3, -0.5, 1.1])
K = [[50.0, 0.0, 15.0], [0.0, 52.0, 11.0], [0.0, 0.0, 1.0]]


def save(path: Path, content: object) -> None:
    """As ZJU-MoCap keeps it: ``numpy.save`` of a dictionary."""
    path.parent.mkdir(parents=True, exist_ok=True)
    holder = np.empty((), dtype=object)
    holder[()] = content
    np.save(path, holder, allow_pickle=True)


@pytest.fixture
def subject(tmp_path: Path) -> Path:
    """One subject, two frames, two cameras of 32 x 24 pixels."""
    root = tmp_path / "zju" / "CoreView_001"
    write_body_model(tmp_path / "zju" / "smpl", "SMPL_NEUTRAL.npz")
    cams = {
        "K": [K, K], "D": [np.zeros((5, 1)), np.array([[0.1], [0.0], [0.0], [0.0], [0.0]])],
        "R": [np.eye(3), TURNED.as_matrix()], "T": [np.array([[100.0], [200.0], [3000.0]])] * 2,
    }  # fmt: skip
    names = [[f"Camera_B{k}/{frame:06d}.jpg" for k in (1, 7)] for frame in (0, 1)]
    save(root / "annots.npy", {"cams": cams, "ims": [{"ims": moment} for moment in names]})
    for frame, moment in enumerate(names):
        fit = {"poses": np.zeros((1, 72), np.float32), "shapes": np.zeros((1, 10)), "Rh": [[0.0, 0.0, 0.5 * frame]],
               "Th": np.array([[0.1, 0.2, 0.3]])}  # fmt: skip
        save(root / "new_params" / f"{frame}.npy", fit)
        for name in moment:
            (root / name).parent.mkdir(exist_ok=True)
            Image.new("RGB", (32, 24), (90, 80, 70)).save(root / name)
            mask = (root / "mask_cihp" / name).with_suffix(".png")
            mask.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.tile(np.array([0, 13], np.uint8), (24, 16))).save(mask)
    return root


def test_a_subject_is_a_person_and_a_sequence(subject: Path) -> None:
    dataset = open_dataset(subject)
    assert guess_format(subject) == guess_format(subject.parent) == "zju_mocap"
    assert list(dataset.persons) == ["CoreView_001"] and not dataset.objects and not dataset.gaps
    assert [view.label for view in dataset.views] == [
        f"CoreView_001_{frame}_{camera}" for frame in ("000000", "000001") for camera in ("B1", "B7")
    ]
    assert {view.ray_share for view in dataset.views} == {0.5}
    assert [view.lens for view in dataset.views[:2]] == [None, Lens(k1=0.1)]


def test_labels_above_zero_are_the_person(subject: Path) -> None:
    pixels = load_pixels(open_dataset(subject).views[0])
    assert pixels.person[:, 1::2].all() and not pixels.person[:, ::2].any()


def test_cameras_map_metres_in_a_millimetre_calibration(subject: Path) -> None:
    camera = open_dataset(subject).views[1].camera
    point = np.array([0.2, -0.1, 0.4])
    seen = np.array(K) @ (TURNED.as_matrix() @ point + [0.1, 0.2, 3.0])
    pixel, depth = camera.project(point)
    assert np.allclose(depth, seen[2]) and np.allclose(pixel, seen[:2] / seen[2] + 0.5)


def test_rh_turns_about_the_origin(subject: Path) -> None:
    dataset = open_dataset(subject)
    model = read_body_model(subject.parent / "smpl" / "SMPL_NEUTRAL.npz")
    rest = model.rest_joints(np.zeros(2))
    turn = Rotation.from_rotvec([0.0, 0.0, 0.5])
    assert np.allclose(dataset.views[2].pose.world_from_bone[:, :3, 3], turn.apply(rest) + [0.1, 0.2, 0.3])
    assert np.allclose(dataset.views[0].pose.world_from_bone[:, :3, 3], rest + [0.1, 0.2, 0.3])


@pytest.mark.parametrize("names", [["B7"], ["Camera_B7"], ["1"]])
def test_a_subset_of_cameras_is_chosen_by_name_or_number(subject: Path, names: list[str]) -> None:
    assert {view.camera_name for view in open_dataset(subject, cameras=names).views} == {"B7"}


def test_frames_are_chosen_and_missing_ones_counted(subject: Path) -> None:
    dataset = read_zju_mocap(subject, ["CoreView_001/000001", "CoreView_001/000009"])
    assert {view.frame for view in dataset.views} == {"000001"} and dataset.gaps == {"frame": 1}


def test_what_is_missing_is_counted(subject: Path) -> None:
    (subject / "mask_cihp" / "Camera_B1" / "000000.png").unlink()
    (subject / "Camera_B7" / "000000.jpg").unlink()
    (subject / "new_params" / "1.npy").unlink()
    with pytest.raises(DatasetError, match=r"missing: 1 x image, 1 x person fit, 1 x person mask"):
        read_zju_mocap(subject)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sequences": ["CoreView_002"]}, "no subject 'CoreView_002'.*it has CoreView_001"),
        ({"cameras": ["B9"]}, "no camera 'B9'.*it has B1, B7"),
    ],
)
def test_unknown_names_are_refused(subject: Path, arguments: dict, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        read_zju_mocap(subject, **arguments)


def test_names_of_early_subjects_count_from_one(subject: Path) -> None:
    """CoreView_313 and 315 call their files after the fit's number."""
    folder = subject / "Camera (1)"
    folder.mkdir()
    name = "Camera (1)/CoreView_313_Camera_(1)_0001_2019-08-23_16-08-50.592.jpg"
    Image.new("RGB", (32, 24)).save(subject / name)
    mask = (subject / "mask_cihp" / name).with_suffix(".png")
    mask.parent.mkdir()
    Image.new("L", (32, 24), 1).save(mask)
    cams = {"K": [K], "D": [np.zeros(5)], "R": [np.eye(3)], "T": [np.zeros(3)]}
    save(subject / "annots.npy", {"cams": cams, "ims": [{"ims": [name]}]})
    (view,) = read_zju_mocap(subject).views
    assert (view.frame, view.camera_name) == ("0001", "Camera (1)")
    turned = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix()
    assert np.allclose(view.pose.world_from_bone[0, :3, :3], turned)


def test_a_pickle_that_would_run_code_is_refused(subject: Path) -> None:
    class Bad:
        def __reduce__(self) -> tuple:
            return print, ("run",)

    save(subject / "annots.npy", {"cams": Bad()})
    with pytest.raises(DatasetError, match=r"annots.npy holds builtins.print, which is refused"):
        read_zju_mocap(subject)


def test_images_outside_of_the_folder_are_refused(subject: Path) -> None:
    cams = {"K": [K], "D": [np.zeros(5)], "R": [np.eye(3)], "T": [np.zeros(3)]}
    save(subject / "annots.npy", {"cams": cams, "ims": [{"ims": ["../../secret.jpg"]}]})
    with pytest.raises(DatasetError, match="outside of its folder"):
        read_zju_mocap(subject)


def test_bodies_of_the_benchmark_lie_on_its_meshes_and_masks(hoibench: Path) -> None:
    dataset = read_zju_mocap(hoibench / "zju_mocap")
    person = dataset.persons["CoreView_386"]
    assert person.surface is not None and len(dataset.views) == 48 and not dataset.gaps
    for view in dataset.views[::11]:
        transforms = canonical_to_world(view.pose.world_from_bone, person.rest_joints)
        blended = np.einsum("vb,bij->vij", person.surface.weights, transforms)
        posed = np.einsum("vij,vj->vi", blended[:, :3, :3], person.surface.vertices) + blended[:, :3, 3]
        stored = np.load(hoibench / "zju_mocap" / "CoreView_386" / "new_vertices" / f"{int(view.frame)}.npy")
        assert np.abs(posed - stored).max() < 1e-6
        drawn = Image.new("L", (4 * view.camera.width, 4 * view.camera.height))
        pen = ImageDraw.Draw(drawn)
        pixels = 4.0 * view.camera.project(posed)[0]
        for face in person.surface.faces:
            pen.polygon([tuple(corner) for corner in pixels[face]], fill=1)
        covered = np.asarray(drawn).reshape(view.camera.height, 4, view.camera.width, 4).mean((1, 3)) > 0.5
        mask = load_pixels(view).person
        assert (covered & mask).sum() / (covered | mask).sum() > 0.945

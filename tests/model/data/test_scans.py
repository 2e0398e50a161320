"""Scanned objects: CO3D's reader and transforms.json against cameras and a ball made here, and the benchmark."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from chona_model.camera import Camera
from chona_model.data.behave_objects import read_ply_vertices
from chona_model.data.dataset import Dataset, DatasetError, View
from chona_model.data.images import load_pixels
from chona_model.data.opener import guess_format, open_dataset
from chona_model.data.placing import HULL_CELLS, MARGIN, hull_points, place

WIDTH, HEIGHT, FOCAL = 48, 36, 60.0
CENTRE, RADIUS = np.array([3.0, -2.0, 5.0]), 0.7
"""A ball somewhere in an arbitrary world."""
DOWN = np.array([0.6, 0.0, 0.8])
"""That world's downward direction."""


def look(angle: float, height: float = 0.4) -> Camera:
    """A camera on a ring around the ball, upright with respect to ``DOWN``."""
    side = np.array([0.0, 1.0, 0.0])
    ahead = np.cross(side, DOWN)
    origin = CENTRE + 3.0 * (np.cos(angle) * side + np.sin(angle) * ahead - height * DOWN)
    forward = (CENTRE - origin) / np.linalg.norm(CENTRE - origin)
    right = np.cross(DOWN, forward) / np.linalg.norm(np.cross(DOWN, forward))
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_from_camera[:3, 3] = origin
    intrinsics = np.array([[FOCAL, 0, 0.5 * WIDTH + 1.5], [0, FOCAL, 0.5 * HEIGHT - 1.0], [0, 0, 1]])
    return Camera(intrinsics, world_from_camera, WIDTH, HEIGHT)


CAMERAS = [look(angle) for angle in np.arange(12) * 2 * np.pi / 12]


def ball(camera: Camera) -> np.ndarray:
    """[H, W] bool: pixels whose ray meets the ball."""
    origins, directions = camera.rays(camera.pixel_centres())
    across = np.cross(directions / np.linalg.norm(directions, axis=-1, keepdims=True), CENTRE - origins)
    return np.linalg.norm(across, axis=-1) < RADIUS


def write_transforms(folder: Path, *, alpha: bool = True, name: str = "transforms.json", **fields: Any) -> Path:
    """The ball's pictures as nerfstudio writes them."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    frames = []
    for index, camera in enumerate(CAMERAS):
        image = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
        path = f"images/frame_{index:03d}.png"
        pixels = np.dstack([image, ball(camera) * np.uint8(255)]) if alpha else image
        Image.fromarray(pixels).save(folder / path)
        matrix = camera.world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append({"file_path": path, "transform_matrix": matrix.tolist()})
    intrinsics = CAMERAS[0].intrinsics
    content = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": intrinsics[0, 2], "cy": intrinsics[1, 2], "w": WIDTH, "h": HEIGHT,
               "camera_model": "OPENCV", "frames": frames, "ply_file_path": "unused.ply"} | fields  # fmt: skip
    (folder / name).write_text(json.dumps(content))
    return folder


def write_co3d(root: Path, kind: str = "ndc_isotropic", cloud: bool = True, score: float | None = 1.5) -> Path:
    """The ball's pictures as CO3D writes them; cameras turned into PyTorch3D's by its own definition."""
    folder = root / "ball"
    for name in ("images", "masks"):
        (folder / "1_2_3" / name).mkdir(parents=True, exist_ok=True)
    half = np.full(2, 0.5 * min(WIDTH, HEIGHT)) if kind == "ndc_isotropic" else 0.5 * np.array([WIDTH, HEIGHT])
    frames = []
    for index, camera in enumerate(CAMERAS):
        image, mask = (f"ball/1_2_3/{name}/frame{index:06d}.png" for name in ("images", "masks"))
        Image.new("RGB", (WIDTH, HEIGHT), (9, 90, 200)).save(root / image)
        Image.fromarray(ball(camera) * np.uint8(255)).save(root / mask)
        turned = camera.world_from_camera[:3, :3] @ np.diag([-1.0, -1.0, 1.0])  # x left, y up: columns are its axes
        centre = camera.intrinsics[:2, 2]
        viewpoint = {
            "R": turned.tolist(), "T": (-camera.world_from_camera[:3, 3] @ turned).tolist(),
            "focal_length": (FOCAL / half).tolist(), "intrinsics_format": kind,
            "principal_point": ((0.5 * np.array([WIDTH, HEIGHT]) - centre) / half).tolist(),
        }  # fmt: skip
        frames.append({
            "sequence_name": "1_2_3", "frame_number": index, "frame_timestamp": 0.1 * index, "viewpoint": viewpoint,
            "image": {"path": image, "size": [HEIGHT, WIDTH]}, "mask": {"path": mask, "mass": 1.0}, "depth": None,
        })  # fmt: skip
    sequence = {"sequence_name": "1_2_3", "category": "ball", "viewpoint_quality_score": score, "video": None,
                "point_cloud": {"path": "ball/1_2_3/pointcloud.ply"} if cloud else None}  # fmt: skip
    for name, content in (("frame_annotations.jgz", frames), ("sequence_annotations.jgz", [sequence])):
        (folder / name).write_bytes(gzip.compress(json.dumps(content).encode()))
    directions = np.random.default_rng(0).normal(size=(500, 3))
    points = CENTRE + RADIUS * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    rows = "\n".join(" ".join(map(str, point)) for point in points)
    properties = "\n".join(f"property float {axis}" for axis in "xyz")
    (folder / "1_2_3" / "pointcloud.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 500\n{properties}\nend_header\n{rows}\n"
    )
    (folder / "set_lists").mkdir(exist_ok=True)
    lists = {"train": [["1_2_3", k, frames[k]["image"]["path"]] for k in (1, 2)], "val": [["1_2_3", 0, "x"]]}
    (folder / "set_lists" / "set_lists_manyview_dev_0.json").write_text(json.dumps(lists))
    return root


def assert_ball_of_half_a_metre(dataset: Dataset, size: float = 0.5) -> None:
    """The ball is upright around the origin, as large as asked for, and seen as its masks show it."""
    (shape,) = dataset.objects.values()
    assert np.abs(shape.upper - (0.5 + MARGIN) * size).max() < 0.06 * size  # the hull of twelve views is no ball
    assert np.allclose(shape.lower, -shape.upper)
    heights = [view.camera.world_from_camera[2, 3] for view in dataset.views]
    assert np.ptp(heights) < 1e-9  # the ring is level, and above the ball, whose hull reaches a little lower
    assert np.mean(heights) == pytest.approx(0.4 * 3.0 * size / (2 * RADIUS), abs=0.1 * size)
    for view in dataset.views:
        assert np.allclose(view.pose.world_from_object, np.eye(4)) and view.pose.person is None
        pixel, depth = view.camera.project(np.zeros(3))
        mask = load_pixels(view).object
        rows, columns = np.nonzero(mask)
        assert (
            np.abs(pixel - [columns.mean() + 0.5, rows.mean() + 0.5]).max() < 1.5
        )  # of 13; cameras from above leave the hull a tip below
        assert depth == pytest.approx(3.0 * np.hypot(1.0, 0.4) * size / (2 * RADIUS), rel=0.08)


def test_transforms_of_nerfstudio(tmp_path: Path) -> None:
    folder = write_transforms(tmp_path / "vase")
    assert guess_format(folder) == guess_format(tmp_path) == "transforms"
    dataset = open_dataset(folder)
    assert list(dataset.objects) == ["vase"] and len(dataset.views) == 12 and not dataset.gaps
    assert_ball_of_half_a_metre(dataset)
    assert {view.ray_share for view in dataset.views} == {0.25}


def test_the_size_of_a_scanned_object_can_be_said(tmp_path: Path) -> None:
    assert_ball_of_half_a_metre(open_dataset(write_transforms(tmp_path / "vase"), object_size=0.2), 0.2)
    with pytest.raises(DatasetError, match=r"longest side is -1\.0 m"):
        place(CAMERAS, np.eye(3), -1.0)


def test_transforms_of_synthetic_scenes(tmp_path: Path) -> None:
    """An angle of view in place of focal lengths, file names without ending, train and test apart in one world."""
    angle = 2.0 * np.arctan(0.5 * WIDTH / FOCAL)
    folder = write_transforms(
        tmp_path / "lego", name="transforms_train.json", camera_angle_x=angle, fl_x=None, fl_y=None
    )
    content = json.loads((folder / "transforms_train.json").read_text())
    for frame in content["frames"]:
        frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")
    for part, frames in (("train", content["frames"][::2]), ("test", content["frames"][1::2])):
        (folder / f"transforms_{part}.json").write_text(json.dumps(content | {"frames": frames}))
    train, test = (open_dataset(folder, sequences=[f"lego_{part}"]) for part in ("train", "test"))
    assert len(train.views) == len(test.views) == 6
    assert np.allclose(train.objects["lego"].upper, test.objects["lego"].upper)
    both = open_dataset(folder)
    assert_ball_of_half_a_metre(both)
    assert {view.label for view in both.views} == {view.label for view in train.views + test.views}
    assert np.allclose(train.views[0].camera.intrinsics[0, 0], FOCAL)


def test_masks_and_lenses_of_transforms(tmp_path: Path) -> None:
    folder = write_transforms(tmp_path / "pot", alpha=False, k1=0.02)
    with pytest.raises(DatasetError, match="neither masks nor an alpha channel; cut the object out"):
        open_dataset(folder)
    content = json.loads((folder / "transforms.json").read_text())
    (folder / "masks").mkdir()
    for frame, camera in zip(content["frames"], CAMERAS, strict=True):
        frame["mask_path"] = frame["file_path"].replace("images", "masks")
        Image.fromarray(ball(camera) * np.uint8(255)).save(folder / frame["mask_path"])
    (folder / "transforms.json").write_text(json.dumps(content))
    dataset = open_dataset(folder)
    assert len(dataset.views) == 12 and dataset.views[0].lens is not None and dataset.views[0].lens.k1 == 0.02


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"camera_model": "OPENCV_FISHEYE"}, "the camera is 'OPENCV_FISHEYE'.*undistort it first"),
        ({"fl_x": None, "fl_y": None}, "neither fl_x nor camera_angle_x"),
        ({"fl_x": -1.0}, "focal lengths must be positive"),
        ({"frames": [{"file_path": "../../x.png", "transform_matrix": np.eye(4).tolist()}]}, "outside of it.*refused"),
        ({"frames": [{"file_path": "images/frame_000.png"}]}, "expected JSON with frames, each with file_path"),
        ({"frames": []}, "no view with an image and a mask .missing: no frames at all"),
    ],
)
def test_what_transforms_cannot_mean_is_refused(tmp_path: Path, fields: dict, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        open_dataset(write_transforms(tmp_path / "vase", **fields))


@pytest.mark.parametrize("kind", ["ndc_isotropic", "ndc_norm_image_bounds"])
@pytest.mark.parametrize("cloud", [True, False])
def test_co3d(tmp_path: Path, kind: str, cloud: bool) -> None:
    dataset = open_dataset(write_co3d(tmp_path, kind, cloud))
    assert guess_format(tmp_path) == guess_format(tmp_path / "ball") == "co3d"
    assert list(dataset.objects) == ["ball_1_2_3"] and len(dataset.views) == 12
    assert dataset.gaps == ({} if cloud else {"point cloud": 1})
    assert_ball_of_half_a_metre(dataset)


def test_set_lists_of_co3d_are_splits(tmp_path: Path) -> None:
    root = write_co3d(tmp_path)
    split = "ball/set_lists/set_lists_manyview_dev_0.json:train"
    dataset = open_dataset(root, split=split)
    assert [view.frame for view in dataset.views] == ["1", "2"]
    whole = open_dataset(root)
    assert np.allclose(dataset.views[0].camera.world_from_camera, whole.views[1].camera.world_from_camera)


def test_bad_cameras_of_co3d_are_left_out_unless_named(tmp_path: Path) -> None:
    root = write_co3d(tmp_path, score=0.1)
    with pytest.raises(DatasetError, match="missing: 1 x sequence with good cameras"):
        open_dataset(root)
    assert len(open_dataset(root, sequences=["1_2_3"]).views) == 12


def test_damaged_annotations_of_co3d_are_named(tmp_path: Path) -> None:
    path = write_co3d(tmp_path) / "ball" / "frame_annotations.jgz"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DatasetError, match=r"cannot read .*frame_annotations.jgz.*copy it again"):
        open_dataset(tmp_path)
    path.write_bytes(gzip.compress(b'[{"sequence_name": 3}]'))
    with pytest.raises(DatasetError, match=r"something else than CO3D's frame annotations.*Expected `str`"):
        open_dataset(tmp_path)


def test_files_outside_of_co3d_are_refused(tmp_path: Path) -> None:
    path = write_co3d(tmp_path) / "ball" / "frame_annotations.jgz"
    frames = json.loads(gzip.decompress(path.read_bytes()))
    frames[0]["mask"]["path"] = "ball/../../secret.png"
    path.write_bytes(gzip.compress(json.dumps(frames).encode()))
    with pytest.raises(DatasetError, match="outside of it"):
        open_dataset(tmp_path)


def test_the_hull_holds_the_ball_and_little_more(tmp_path: Path) -> None:
    views: list[View] = list(open_dataset(write_transforms(tmp_path / "vase")).views)
    points = hull_points(views)
    radius = np.linalg.norm(points, axis=1) / (0.5 / (2 * RADIUS))
    assert radius.max() < 1.35 * RADIUS  # twelve views on one ring leave caps above and below
    cell = 2.0 * np.abs(points).max() / HULL_CELLS[-1]
    assert (np.abs(points).max(axis=0) > 0.5 * 0.5 - 2 * cell).all()


def test_the_benchmark_fits_its_masks(hoibench: Path) -> None:
    dataset = open_dataset(hoibench / "co3d")
    assert len(dataset.views) == 48 and set(dataset.objects) == {"bowl_70_5774_13292", "chair_248_25087_49638"}
    for name, shape in dataset.objects.items():
        category, sequence = name.split("_", 1)
        cloud = read_ply_vertices(hoibench / "co3d" / category / sequence / "pointcloud.ply")
        views = [view for view in dataset.views if view.pose.objects == (name,)]
        heights = np.array([view.camera.world_from_camera[2, 3] for view in views])
        assert heights.min() > 0.0 and np.isclose(2 * shape.upper.max(), 0.5 * (1 + 2 * MARGIN))
        for view in views[::5]:
            corners = np.stack([shape.lower, shape.upper])
            box = np.array([[x, y, z] for x in corners[:, 0] for y in corners[:, 1] for z in corners[:, 2]])
            pixel, _ = view.camera.project(box)
            rows, columns = np.nonzero(load_pixels(view).object)
            assert (pixel.min(0) < [columns.min(), rows.min()]).all()
            assert (pixel.max(0) > [columns.max(), rows.max()]).all()
        assert len(cloud) > 500

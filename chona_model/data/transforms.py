"""Reader of ``transforms.json``: a static object scanned with a phone, as nerfstudio, instant-ngp and COLMAP's
exporters write it, and as NeRF's synthetic scenes have it (``transforms_train.json`` …).

::

    <scan>/transforms.json     fl_x, fl_y, cx, cy, w, h, k1 … (for all, or for each frame), or camera_angle_x
           images/frame_00001.png                                   frames[].file_path, transform_matrix
           masks/frame_00001.png                                    frames[].mask_path; else the images' alpha channel

What they mean, and what is done here: ``transform_matrix`` is camera to world with OpenGL's axes (x right, y up, z
back); pixel centres are at +0.5.  World, direction and scale are arbitrary and set as ``placing.py`` says.  Pictures
need masks or an alpha channel: without, the whole room would be learned as the object.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from chona_model.camera import Camera, CameraError, is_rotation
from chona_model.data.dataset import Dataset, DatasetError, MaskRule, View
from chona_model.data.images import opened_image
from chona_model.data.lens import Lens
from chona_model.data.paths import named_file
from chona_model.data.placing import LONGEST_SIDE, Placing, hull_points, place, static_pose
from chona_model.data.reading import chosen_frames, counted
from chona_model.plain_json import JsonError, decode, read_text, shortened
from chona_model.skeleton import SMPL

PATTERN = "transforms*.json"
MAX_BYTES = 256 << 20
MOST_SIDE = 1 << 20
"""Pixels; a stated width or height beyond is no image's."""
RAY_SHARE = 0.25
ENDINGS = ("", ".png", ".jpg", ".jpeg")
"""NeRF's synthetic scenes leave the ending out."""
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
CAMERA_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV")
_ALPHA_MODES = ("RGBA", "LA", "PA")


class _Intrinsics(msgspec.Struct):
    """Fields that the file has for all frames, and a frame for itself."""

    fl_x: float | None = None
    fl_y: float | None = None
    cx: float | None = None
    cy: float | None = None
    w: float | None = None
    h: float | None = None
    camera_angle_x: float | None = None
    camera_model: str | None = None
    is_fisheye: bool | None = None
    k1: float | None = None
    k2: float | None = None
    k3: float | None = None
    k4: float | None = None
    p1: float | None = None
    p2: float | None = None


class _Frame(_Intrinsics, kw_only=True):
    file_path: str
    transform_matrix: list[list[float]]
    mask_path: str | None = None


class _Scan(_Intrinsics, kw_only=True):
    frames: list[_Frame]


@dataclass(frozen=True)
class _File:
    """One transforms file: a sequence of a scanned object."""

    path: Path
    sequence: str
    identity: str


def read_transforms(root: Path, sequences: Sequence[str] | None = None, object_size: float | None = None) -> Dataset:
    """Reads scans; the object is called as the scan's folder.

    Args:
        root: a scan's folder, or one that holds several.
        sequences: names (the folder's; ``FOLDER_train`` of ``transforms_train.json``) or ``SEQUENCE/FRAME`` with the
            image's name without its ending; all when None.
        object_size: metres of the objects' longest side; ``LONGEST_SIDE`` when None.

    Raises:
        DatasetError: no such scan, a fisheye or panoramic camera, pictures without masks, or nothing usable.
    """
    files = _files(root)
    wanted = chosen_frames(sorted({file.sequence for file in files}), sequences, "scan", root)
    gaps: Counter[str] = Counter()
    views: list[View] = []
    placings: dict[str, Placing] = {}
    for identity in dict.fromkeys(file.identity for file in files if file.sequence in wanted):
        # All of a scan's files say where the object is: training and test views must share one world.
        scanned = [view for file in files if file.identity == identity for view in _views(file, gaps)]
        if not scanned:
            continue
        size = object_size or LONGEST_SIDE
        placings[identity] = place([view.camera for view in scanned], hull_points(scanned), size)
        views.extend(
            replace(view, camera=placings[identity].camera(view.camera))
            for view in scanned
            if view.sequence in wanted and (wanted[view.sequence] is None or view.frame in wanted[view.sequence])  # type: ignore[operator]
        )
    if not views:
        raise DatasetError(
            f"{root} has no view with an image and a mask (missing: {counted(gaps)}); check the paths in its files"
        )
    objects = {name: placing.shape(name) for name, placing in placings.items()}
    return Dataset(SMPL, {}, objects, tuple(views), gaps)


def _files(root: Path) -> list[_File]:
    """Every transforms file of ``root`` or of the folders in it."""
    for folders in ([root], sorted(path for path in root.iterdir() if path.is_dir())):
        found = [
            _File(path, _sequence_name(path), path.resolve().parent.name)
            for folder in folders
            for path in sorted(folder.glob(PATTERN))
        ]
        if found:
            return found
    raise DatasetError(f"{root} has no {PATTERN}; expected a scan as nerfstudio or instant-ngp write it")


def _sequence_name(path: Path) -> str:
    part = path.stem.removeprefix("transforms").strip("_")
    name = path.resolve().parent.name
    return f"{name}_{part}" if part else name


def _views(file: _File, gaps: Counter[str]) -> list[View]:
    """Views in the scan's own world."""
    scan = _read(file.path)
    pose = static_pose(file.identity)
    views = []
    for frame in scan.frames:
        image = _located(file.path.parent, frame.file_path)
        if image is None:
            gaps["image"] += 1
            continue
        mask, rule = _mask(file.path.parent, frame, image)
        if mask is None:
            gaps["object mask"] += 1
            continue
        camera, lens = _camera(file.path, scan, frame, image)
        views.append(
            View(file.sequence, Path(frame.file_path).stem, "phone", camera, pose, image, object_mask=mask,
                 masks=rule, lens=lens, ray_share=RAY_SHARE)
        )  # fmt: skip
    if scan.frames and not views and gaps["object mask"]:
        raise DatasetError(
            f"the pictures of {file.path} have neither masks nor an alpha channel; cut the object out (any tool for "
            "background removal that writes PNG with alpha does) or name masks with mask_path in its frames"
        )
    return views


def _read(path: Path) -> _Scan:
    try:
        return decode(read_text(path, MAX_BYTES), _Scan)
    except (OSError, JsonError) as error:
        raise DatasetError(
            f"cannot read {path}: {error}; expected JSON with frames, each with file_path and transform_matrix"
        ) from error


def _located(folder: Path, name: str) -> Path | None:
    """A file that the scan names, with or without its ending; None where it is not there.

    Raises:
        DatasetError: the name leads out of the scan's folder.
    """
    found = (named_file(folder, name + ending, f"the scan in {folder}") for ending in ENDINGS)
    return next((path for path in found if path is not None), None)


def _mask(folder: Path, frame: _Frame, image: Path) -> tuple[Path | None, MaskRule]:
    if frame.mask_path is not None:
        return _located(folder, frame.mask_path), MaskRule()
    with opened_image(image) as picture:
        return (image if picture.mode in _ALPHA_MODES else None), MaskRule(alpha=True)


def _camera(path: Path, scan: _Scan, frame: _Frame, image: Path) -> tuple[Camera, Lens | None]:
    def field(name: str) -> float | None:
        own = getattr(frame, name)
        return own if own is not None else getattr(scan, name)

    model = frame.camera_model or scan.camera_model or "OPENCV"
    if model not in CAMERA_MODELS or frame.is_fisheye or scan.is_fisheye:
        raise DatasetError(
            f"{path}: the camera is '{model}', expected one of {', '.join(CAMERA_MODELS)}; undistort it first"
        )
    if field("w") is None or field("h") is None:
        with opened_image(image) as picture:
            width, height = picture.size
    else:
        width, height = round(min(field("w") or 0, MOST_SIDE)), round(min(field("h") or 0, MOST_SIDE))
    focal_x, angle = field("fl_x"), field("camera_angle_x")
    if focal_x is None and angle is not None and 0.0 < angle < np.pi:
        focal_x = 0.5 * width / np.tan(0.5 * angle)
    try:
        matrix = np.array(frame.transform_matrix, dtype=np.float64)
        if focal_x is None:
            raise ValueError("there is neither fl_x nor camera_angle_x")
        if matrix.shape != (4, 4):
            raise ValueError(f"transform_matrix has the shape {matrix.shape}, expected 4x4")
        if not is_rotation(matrix[:3, :3]):
            raise ValueError("transform_matrix is not rigid (to 0.001)")
        focal_y, centre_x, centre_y = field("fl_y") or focal_x, field("cx"), field("cy")
        intrinsics = np.array(
            [[focal_x, 0.0, 0.5 * width if centre_x is None else centre_x],
             [0.0, focal_y, 0.5 * height if centre_y is None else centre_y],
             [0.0, 0.0, 1.0]]
        )  # fmt: skip
        rational = field("k4") or 0.0
        if abs(rational) > 0.0:
            raise ValueError("k4 belongs to a fisheye or a rational lens; undistort the images first")
        lens = Lens.opencv(np.array([field(name) or 0.0 for name in ("k1", "k2", "p1", "p2", "k3")]))
        return Camera(intrinsics, matrix @ OPENCV_FROM_OPENGL, width, height), lens
    except (ValueError, OverflowError, CameraError) as error:
        raise DatasetError(f"{path}: frame {shortened(frame.file_path)}: {error}") from error

"""Reader of ZJU-MoCap's layout: one person, up to 23 cameras, SMPL fits.

::

    <subject>/annots.npy                      cams: K, D, R, T of every camera; ims: image files of each frame
              Camera_B1/000000.jpg            (CoreView_313 and 315: "Camera (1)/CoreView_313_Camera_(1)_0001_….jpg")
              mask_cihp/Camera_B1/000000.png  labels of body parts, 0 is background; mask/… where this one is missing
              new_params/0.npy                poses [1, 72], Rh, Th [1, 3], shapes [1, 10]

What ZJU-MoCap means, and what is done here: the world is z up; ``x_cam = R x_world + T / 1000``; pixel centres lie at
integers, so half a pixel is added to the principal point; images are undistorted (K, D) when they are read.  A body is
``LBS(poses, shapes) R(Rh)ᵀ + Th`` with the root's own rotation zero: Rh turns about the origin, not about the pelvis.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from chona_model.camera import Camera, CameraError, is_rotation, rigid
from chona_model.data.body_model import BodyModel, body_model_folders, find_body_model, read_body_model, reduced_pose
from chona_model.data.dataset import Dataset, DatasetError, MaskRule, Person, Pose, SkinnedSurface, View
from chona_model.data.images import opened_image
from chona_model.data.lens import Lens
from chona_model.data.paths import named_file
from chona_model.data.reading import chosen_frames, counted, is_usable, real_numbers
from chona_model.data.restricted_pickle import MODEL_BYTES, read_object_npy
from chona_model.plain_json import shortened
from chona_model.skeleton import SMPL

GENDER = "neutral"
MILLIMETRES = 1000.0
LABELS = MaskRule(above=0)
MASK_FOLDERS = ("mask_cihp", "mask")
RAY_SHARE = 0.5
"""1024 rays of an image where BEHAVE's have 2048 (paper, section 4)."""

_COUNTED_FROM_ONE = re.compile(r"CoreView_[0-9]+_Camera_\([0-9]+\)_([0-9]{1,18})_")
"""File names of CoreView_313 and 315 hold the number of the fit, which begins at 1."""


@dataclass(frozen=True)
class _Subject:
    """``annots.npy`` of one subject: C cameras with their lenses, and their image files in every moment."""

    folder: Path
    cameras: tuple[Camera, ...]
    lenses: tuple[Lens | None, ...]
    names: tuple[str, ...]
    images: tuple[tuple[str, ...], ...]


def read_zju_mocap(
    root: Path,
    sequences: Sequence[str] | None = None,
    body_model_dir: Path | None = None,
    cameras: Sequence[str] | None = None,
) -> Dataset:
    """Reads subjects of a folder in ZJU-MoCap's layout; a subject is a person and a sequence of its folder's name.

    Args:
        root: a subject's folder, or the folder that holds some.
        sequences: names of subjects, or ``SUBJECT/FRAME`` (``CoreView_386/000012``); all when None.
        body_model_dir: folder with SMPL files; else $CHONA_BODY_MODELS, ``smplh`` or ``smpl`` in or beside ``root``.
        cameras: names (``B1`` or ``Camera_B1``) or numbers from 0 of the cameras used; all when None.

    Raises:
        DatasetError: no such subject, frame or camera, no body model, or nothing usable.
    """
    gaps: Counter[str] = Counter()
    subjects = _chosen(root, sequences)
    above = (root.resolve(), root.resolve().parent, root.resolve().parent.parent)
    folders = body_model_folders(body_model_dir, [folder / name for folder in above for name in ("smplh", "smpl")])
    model = read_body_model(find_body_model(folders, GENDER)).reduced()
    persons: dict[str, Person] = {}
    views: list[View] = []
    for folder, wanted in subjects.items():
        subject = _read_subject(folder)
        used = _used_cameras(subject, cameras)
        shapes: list[np.ndarray] = []
        found: list[View] = []
        for files in subject.images:
            fit_name, frame = _moment(files[0])
            if wanted is not None and frame not in wanted:
                continue
            parameters = _read_fit(folder / "new_params" / f"{fit_name}.npy", gaps)
            if parameters is None:
                continue
            shapes.append(parameters["shapes"])
            pose = Pose(folder.name, (), _world_from_bone(model, parameters), np.empty((0, 4, 4)))
            found.extend(_views(subject, used, files, frame, pose, gaps))
        if wanted is not None:
            gaps["frame"] += len(wanted - {view.frame for view in found})
        if found:
            shape = np.mean(shapes, axis=0)
            surface = SkinnedSurface(model.shaped(shape), model.weights, model.faces)
            persons[folder.name] = Person(folder.name, model.rest_joints(shape), surface)
            views.extend(found)
    if not views:
        raise DatasetError(
            f"{root} has no view with an image, a mask and a fit (missing: {counted(gaps)}); expected "
            "Camera_B1/000000.jpg, mask_cihp/Camera_B1/000000.png and new_params/0.npy"
        )
    return Dataset(SMPL, persons, {}, tuple(views), gaps)


def subject_folders(root: Path) -> list[Path]:
    """Folders with ``annots.npy``: ``root``, or those in ``root`` or ``root/zju_mocap``."""
    if (root / "annots.npy").is_file():
        return [root]
    for parent in (root, root / "zju_mocap"):
        found = sorted(path.parent for path in parent.glob("*/annots.npy"))
        if found:
            return found
    return []


def _chosen(root: Path, sequences: Sequence[str] | None) -> dict[Path, frozenset[str] | None]:
    """Wanted frames by subject; None stands for all."""
    present = {folder.resolve().name: folder.resolve() for folder in subject_folders(root)}
    if not present:
        raise DatasetError(f"{root} has no subject of ZJU-MoCap; expected SUBJECT/annots.npy, such as CoreView_386")
    return {present[name]: frames for name, frames in chosen_frames(present, sequences, "subject", root).items()}


def _read_subject(folder: Path) -> _Subject:
    path = folder / "annots.npy"
    content = read_object_npy(path, MODEL_BYTES)
    try:
        calibration = {key: content["cams"][key] for key in ("K", "D", "R", "T")}
        images = tuple(tuple(str(name).replace("\\", "/") for name in moment["ims"]) for moment in content["ims"])
        count = len(calibration["K"])
    except (KeyError, TypeError, IndexError) as error:
        raise DatasetError(
            f"{path} lacks {shortened(error)}; expected ZJU-MoCap's cams (K, D, R, T) and ims"
        ) from error
    if not images or not count or any(len(moment) < count for moment in images):
        raise DatasetError(f"{path} has {count} cameras and fewer images in some frame; the file is damaged")
    size = _image_size(folder, images)
    cameras, lenses = zip(*(_camera(path, calibration, index, size) for index in range(count)), strict=True)
    names = tuple(Path(name).parent.name.replace("Camera_", "") or str(k) for k, name in enumerate(images[0][:count]))
    return _Subject(folder, cameras, lenses, names, images)


def _image_size(folder: Path, images: Iterable[Sequence[str]]) -> tuple[int, int]:
    """Height and width of the first image there is; all of a subject's are alike."""
    for name in (name for moment in images for name in moment):
        path = named_file(folder, name, folder / "annots.npy")
        if path is not None:
            with opened_image(path) as image:
                return image.height, image.width
    raise DatasetError(f"{folder} has none of the images that its annots.npy names; copy the folders Camera_… into it")


def _camera(path: Path, cams: dict[str, Any], index: int, size: tuple[int, int]) -> tuple[Camera, Lens | None]:
    try:
        intrinsics = real_numbers(cams["K"][index]).reshape(3, 3)
        rotation = real_numbers(cams["R"][index]).reshape(3, 3)
        translation = real_numbers(cams["T"][index]).reshape(3) / MILLIMETRES
        lens = Lens.opencv(real_numbers(cams["D"][index]))
        if not is_rotation(rotation):
            raise ValueError("R is not a rotation (to 0.001)")
        intrinsics[:2, 2] += 0.5  # ZJU-MoCap puts the centre of the first pixel at 0, this package at 0.5
        return Camera(intrinsics, rigid(rotation.T, -rotation.T @ translation), size[1], size[0]), lens
    except (IndexError, KeyError, TypeError, ValueError, OverflowError, CameraError) as error:
        raise DatasetError(
            f"{path}: camera {index} is not ZJU-MoCap's: {error}; expected K and R [3, 3], T [3] millimetres, D [5]"
        ) from error


def _used_cameras(subject: _Subject, wanted: Sequence[str] | None) -> list[int]:
    if wanted is None:
        return list(range(len(subject.cameras)))
    known = {name: index for index, name in enumerate(subject.names)}
    known |= {f"Camera_{name}": index for name, index in known.items()}
    known |= {str(index): index for index in range(len(subject.names)) if str(index) not in known}
    unknown = next((name for name in wanted if name not in known), None)
    if unknown is not None:
        raise DatasetError(f"there is no camera '{unknown}' in {subject.folder}; it has {', '.join(subject.names)}")
    return sorted({known[name] for name in wanted})


def _moment(image: str) -> tuple[int, str]:
    """Number of the fit, and the frame's name, of an image's file name."""
    stem = Path(image).stem
    counted = _COUNTED_FROM_ONE.match(Path(image).name)
    if counted is not None:
        return int(counted[1]), counted[1]
    if not re.fullmatch(r"[0-9]{1,18}", stem):
        raise DatasetError(f"the image {image} of annots.npy has no frame number; expected Camera_B1/000000.jpg")
    return int(stem), stem


def _read_fit(path: Path, gaps: Counter[str]) -> dict[str, np.ndarray] | None:
    """Arrays of a fit; None, counted, where there is none or it holds a NaN."""
    if not path.is_file():
        gaps["person fit"] += 1
        return None
    content = read_object_npy(path)
    keys = ("poses", "shapes", "Rh", "Th")
    try:
        arrays = {key: real_numbers(content[key]).reshape(-1) for key in keys}
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: {error}; expected arrays poses, shapes, Rh and Th") from error
    if not is_usable(arrays, ("Rh", "Th"), path):
        gaps["person fit (not finite)"] += 1
        return None
    return arrays


def _world_from_bone(model: BodyModel, fit: dict[str, np.ndarray]) -> np.ndarray:
    world_from_fit = rigid(Rotation.from_rotvec(fit["Rh"]).as_matrix(), fit["Th"])
    return world_from_fit @ model.world_from_bone(reduced_pose(fit["poses"]), fit["shapes"], np.zeros(3))


def _views(
    subject: _Subject, used: Sequence[int], files: Sequence[str], frame: str, pose: Pose, gaps: Counter[str]
) -> Iterable[View]:
    for index in used:
        source = subject.folder / "annots.npy"
        image = named_file(subject.folder, files[index], source)
        names = (Path(folder, files[index]).with_suffix(".png") for folder in MASK_FOLDERS)
        masks = (named_file(subject.folder, str(name), source) for name in names)
        mask = next((path for path in masks if path is not None), None)
        if image is None:
            gaps["image"] += 1
        elif mask is None:
            gaps["person mask"] += 1
        else:
            yield View(
                subject.folder.name, frame, subject.names[index], subject.cameras[index], pose, image, mask,
                masks=LABELS, lens=subject.lenses[index], ray_share=RAY_SHARE,
            )  # fmt: skip

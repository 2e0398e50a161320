"""Reader of BEHAVE's layout: four Kinects, SMPL-H fits of the person and rigid fits of one object.

::

    calibs/intrinsics/<k>/calibration.json     calibs/<Date>/config/<k>/config.json (camera to world)
    objects/<name>/<name>.obj, <name>_f1000.ply
    sequences/<Date>_<Sub>_<object>[_<action>]/info.json
                                              /t0003.000/k<k>.color.jpg, k<k>.person_mask.jpg, k<k>.obj_rend_mask.jpg
                                                        /person/fit02/person_fit.pkl   <object>/fit01/<object>_fit.pkl

What BEHAVE means, and what is done here: the world is the colour camera of Kinect 1 (OpenCV axes), turned here until z
points up as everywhere else, since a learned light stays where it was in the world; pixel centres lie at integers, so
half a pixel is added to the principal point; an object is ``R (v0 - c) + trans`` with c the
mean vertex of its *simplified* template, so its frame is ``[R | trans]`` and its extent that of ``v0 - c``.  Frames and
views with parts missing are skipped and counted in ``Dataset.gaps``: a person without a mask would be taught as empty.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from chona_model.camera import Camera, rigid
from chona_model.data.behave_cameras import UPRIGHT, read_camera
from chona_model.data.behave_objects import read_object_shape
from chona_model.data.body_model import BodyModel, body_model_folders, find_body_model, read_body_model, reduced_pose
from chona_model.data.dataset import Dataset, DatasetError, Person, Pose, SkinnedSurface, View
from chona_model.data.lens import Lens
from chona_model.data.reading import chosen_frames, counted, is_usable, json_object, real_numbers
from chona_model.data.restricted_pickle import read_pickle
from chona_model.skeleton import SMPL

OBJECT_MASKS = ("obj_rend_mask.jpg", "obj_rend_mask.png", "obj_mask.jpg", "obj_mask.png")
PERSON_MASKS = ("person_mask.jpg", "person_mask.png")
MOST_KINECTS = 64
OBJECT_FOLDERS = {"basketball": "sports ball", "yogaball": "sports ball", "chairblack": "chair", "chairwood": "chair"}
"""BEHAVE names some fits by the detector's category and not by the object."""


@dataclass(frozen=True)
class _Fit:
    """A kind of fitted parameters: its name in messages, its folders by preference, its arrays."""

    kind: str
    folders: tuple[str, ...]
    keys: tuple[str, ...]


PERSON_FIT = _Fit("person fit", ("fit02", "fit01"), ("pose", "betas", "trans"))
OBJECT_FIT = _Fit("object fit", ("fit01", "fit02"), ("angle", "trans"))


@dataclass(frozen=True)
class _Sequence:
    """One sequence folder: what its name and info.json say."""

    name: str
    folder: Path
    person: str
    object: str
    gender: str
    kinects: tuple[int, ...]
    info: dict[str, Any]


@dataclass(frozen=True)
class _Frame:
    """The fits of one frame."""

    sequence: _Sequence
    folder: Path
    pose: np.ndarray
    betas: np.ndarray
    trans: np.ndarray
    world_from_object: np.ndarray


def read_behave(root: Path, sequences: Sequence[str] | None = None, body_model_dir: Path | None = None) -> Dataset:
    """Reads sequences of a folder in BEHAVE's layout.

    Args:
        root: the folder that holds ``sequences`` (or a folder with that folder in ``behave``).
        sequences: names of sequences, or ``SEQUENCE/FRAME`` for single frames; all when None.
        body_model_dir: folder with SMPL-H files; else $CHONA_BODY_MODELS, ``smplh`` beside ``root`` or inside it.

    Raises:
        DatasetError: no such sequence, no calibration, no body model, or nothing usable at all.
    """
    root = data_root(root)
    gaps: Counter[str] = Counter()
    frames = [
        frame
        for name, wanted in chosen_frames(_present(root), sequences, "sequence", root / "sequences").items()
        for frame in _read_frames(_read_sequence(root / "sequences" / name), wanted, gaps)
    ]
    if not frames:
        raise DatasetError(
            f"no frame of {root / 'sequences'} has both a person's and an object's fit (missing: {counted(gaps)}); "
            "expected t0003.000/person/fit02/person_fit.pkl and t0003.000/OBJECT/fit01/OBJECT_fit.pkl"
        )
    models = _body_models(root, body_model_dir, {frame.sequence.gender for frame in frames})
    persons = _read_persons(frames, models)
    objects = {
        name: read_object_shape(root / "objects" / name, name, gaps)
        for name in dict.fromkeys(frame.sequence.object for frame in frames)
    }
    cameras: dict[str, dict[int, tuple[Camera, Lens | None]]] = {}
    views: list[View] = []
    for frame in frames:
        sequence = frame.sequence
        if sequence.name not in cameras:
            cameras[sequence.name] = {
                kinect: read_camera(root, sequence.folder, sequence.info, kinect) for kinect in sequence.kinects
            }
        bones = models[sequence.gender].world_from_bone(reduced_pose(frame.pose), frame.betas, frame.trans)
        pose = Pose(sequence.person, (sequence.object,), UPRIGHT @ bones, UPRIGHT @ frame.world_from_object[None])
        views.extend(_views(frame, pose, cameras[sequence.name], gaps))
    if not views:
        raise DatasetError(f"no view in {root / 'sequences'} has an image and both masks; expected k0.color.jpg, ...")
    return Dataset(SMPL, persons, objects, tuple(views), gaps)


def data_root(root: Path) -> Path:
    """The folder that holds ``sequences``: ``root`` or ``root/behave``.

    Raises:
        DatasetError: neither does.
    """
    for folder in (root, root / "behave"):
        if (folder / "sequences").is_dir():
            return folder
    raise DatasetError(f"{root} has no folder 'sequences'; expected BEHAVE's layout (calibs, objects, sequences)")


def _present(root: Path) -> list[str]:
    return sorted(path.name for path in (root / "sequences").iterdir() if path.is_dir())


def _read_sequence(folder: Path) -> _Sequence:
    info = json_object(folder / "info.json", "the sequence's config, intrinsic, gender and kinects")
    parts = folder.name.split("_")
    if len(parts) < 3:
        raise DatasetError(f"the sequence folder is called '{folder.name}', expected DATE_SUBJECT_OBJECT[_ACTION]")
    gender, kinects = str(info.get("gender", "male")), info.get("kinects", [0, 1, 2, 3])
    if not re.fullmatch(r"\w{1,20}", gender):
        raise DatasetError(f"{folder / 'info.json'}: gender is {gender[:60]!r}, expected male, female or neutral")
    if not (isinstance(kinects, list) and kinects and all(k in range(MOST_KINECTS) for k in kinects)):
        raise DatasetError(
            f"{folder / 'info.json'}: kinects is {str(kinects)[:60]}, expected a list of numbers like [0, 1, 2, 3]"
        )
    return _Sequence(folder.name, folder, parts[1], parts[2], gender, tuple(kinects), info)


def _read_frames(sequence: _Sequence, wanted: frozenset[str] | None, gaps: Counter[str]) -> Iterable[_Frame]:
    present = {path.name: path for path in sequence.folder.iterdir() if re.fullmatch(r"t\d+(\.\d+)?", path.name)}
    if wanted is not None:
        gaps.update(["frame"] * len(wanted - present.keys()))
    for name in sorted(present):
        if wanted is not None and name not in wanted:
            continue
        folder = present[name]
        body = _read_fit(folder, ("person",), PERSON_FIT, gaps)
        names = (sequence.object, OBJECT_FOLDERS.get(sequence.object, sequence.object), _category(sequence))
        thing = _read_fit(folder, names, OBJECT_FIT, gaps)
        if body is None or thing is None:
            continue
        world_from_object = rigid(Rotation.from_rotvec(thing["angle"]).as_matrix(), thing["trans"])
        yield _Frame(sequence, folder, body["pose"], body["betas"], body["trans"], world_from_object)


def _read_fit(folder: Path, names: tuple[str, ...], fit: _Fit, gaps: Counter[str]) -> dict[str, np.ndarray] | None:
    """Arrays of the first fit found; None, counted, when there is none or it holds a NaN."""
    for path in (folder / name / part / f"{name}_fit.pkl" for name in names for part in fit.folders):
        if not path.is_file():
            continue
        content = read_pickle(path)
        if not isinstance(content, dict) or any(key not in content for key in fit.keys):
            raise DatasetError(f"{path} lacks one of {', '.join(fit.keys)}; expected BEHAVE's fitted parameters")
        try:
            arrays = {key: real_numbers(content[key]).reshape(-1) for key in fit.keys}
        except (TypeError, ValueError) as error:
            raise DatasetError(f"{path}: {error}; expected arrays of numbers in {', '.join(fit.keys)}") from error
        if is_usable(arrays, ("angle", "trans"), path):
            return arrays
        gaps[f"{fit.kind} (not finite)"] += 1
        return None
    gaps[fit.kind] += 1
    return None


def _body_models(root: Path, explicit: Path | None, genders: set[str]) -> dict[str, BodyModel]:
    folders = body_model_folders(explicit, [root.resolve().parent / "smplh", root / "smplh"])
    return {gender: read_body_model(find_body_model(folders, gender)).reduced() for gender in sorted(genders)}


def _read_persons(frames: list[_Frame], models: dict[str, BodyModel]) -> dict[str, Person]:
    """Persons with the mean shape over their frames: one identity has one canonical body."""
    betas: dict[str, list[np.ndarray]] = defaultdict(list)
    genders: dict[str, str] = {}
    for frame in frames:
        sequence = frame.sequence
        if genders.setdefault(sequence.person, sequence.gender) != sequence.gender:
            raise DatasetError(
                f"{sequence.person} is {genders[sequence.person]} in one sequence and {sequence.gender} in "
                f"{sequence.name}/info.json; correct the gender"
            )
        betas[sequence.person].append(frame.betas)
    persons = {}
    for name, shapes in betas.items():
        if len({shape.size for shape in shapes}) > 1:
            raise DatasetError(f"the fits of {name} have different numbers of betas; use fits of one body model")
        model, shape = models[genders[name]], np.mean(shapes, axis=0)
        surface = SkinnedSurface(model.shaped(shape), model.weights, model.faces)
        persons[name] = Person(name, model.rest_joints(shape), surface)
    return persons


def _category(sequence: _Sequence) -> str:
    """What info.json says the object is, where that can be a folder's name."""
    stated = sequence.info.get("cat")
    return stated if isinstance(stated, str) and re.fullmatch(r"[\w -]{1,60}", stated) else sequence.object


def _views(
    frame: _Frame, pose: Pose, cameras: dict[int, tuple[Camera, Lens | None]], gaps: Counter[str]
) -> Iterable[View]:
    for kinect, (camera, lens) in cameras.items():
        image = _first(frame.folder, f"k{kinect}", ("color.jpg", "color.png"))
        masks = [_first(frame.folder, f"k{kinect}", endings) for endings in (PERSON_MASKS, OBJECT_MASKS)]
        for kind, path in zip(("image", "person mask", "object mask"), (image, *masks), strict=True):
            if path is None:
                gaps[kind] += 1
        if image is not None and None not in masks:
            yield View(
                frame.sequence.name, frame.folder.name, f"k{kinect}", camera, pose, image, masks[0], masks[1], lens=lens
            )


def _first(folder: Path, stem: str, endings: tuple[str, ...]) -> Path | None:
    return next((path for path in (folder / f"{stem}.{ending}" for ending in endings) if path.is_file()), None)

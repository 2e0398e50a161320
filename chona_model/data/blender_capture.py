"""Reader of captured Blender scenes, the format in ``docs/file-formats.md`` ("Captured Blender scene")."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from chona_model.camera import FARTHEST, Camera, CameraError
from chona_model.data.dataset import Dataset, DatasetError, ObjectShape, Person, Pose, SkinnedSurface, View
from chona_model.data.paths import check_name
from chona_model.data.reading import chosen_frames, counted, real_numbers
from chona_model.plain_arrays import ArraysError, read_arrays
from chona_model.plain_json import JsonError, decode, read_text
from chona_model.skeleton import Skeleton, SkeletonError

FORMAT = "chona-capture"
VERSION = 1
RIGID_TOLERANCE = 1e-4

MOST_SIDE = 65536
"""Pixels of an image each way."""


class _Kind(msgspec.Struct):
    """What every version has."""

    format: str
    version: int


class _Skeleton(msgspec.Struct, forbid_unknown_fields=True):
    names: list[str]
    parents: list[int]


class _Person(msgspec.Struct, forbid_unknown_fields=True):
    rest_joints: list[list[float]]


class _Object(msgspec.Struct, forbid_unknown_fields=True):
    lower: list[float]
    upper: list[float]


class _Sequence(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    person: str | None
    objects: list[str]
    cameras: list[str]
    width: int
    height: int


class _Capture(msgspec.Struct, forbid_unknown_fields=True):
    format: str
    version: int
    skeleton: _Skeleton
    persons: dict[str, _Person]
    objects: dict[str, _Object]
    sequences: list[_Sequence]


def read_blender_capture(root: Path, sequences: Sequence[str] | None = None) -> Dataset:
    """Reads sequences of a captured Blender scene.

    Views without an image, or without the mask of a part the sequence has, are skipped and counted in ``gaps``.

    Args:
        root: the folder with ``capture.json``.
        sequences: names, or ``SEQUENCE/FRAME`` for single frames (``lift/0003``); all when None.

    Raises:
        DatasetError: an unfinished or damaged capture, an unknown sequence, or nothing usable.
    """
    capture = _read_header(root)
    skeleton, persons, objects = _identities(root, capture)
    gaps: Counter[str] = Counter()
    by_name = {sequence.name: sequence for sequence in capture.sequences}
    views: list[View] = []
    for name, wanted in chosen_frames(by_name, sequences, "sequence", root).items():
        views.extend(_read_sequence(root, by_name[name], wanted, (skeleton, persons, objects), gaps))
    if not views:
        raise DatasetError(
            f"the capture {root} has no view with its image and masks ({counted(gaps)}); capture it again"
        )
    used_persons = {view.pose.person for view in views}
    used_objects = {name for view in views for name in view.pose.objects}
    return Dataset(
        skeleton,
        {name: person for name, person in persons.items() if name in used_persons},
        {name: shape for name, shape in objects.items() if name in used_objects},
        tuple(views),
        gaps,
    )


def _read_header(root: Path) -> _Capture:
    path = root / "capture.json"
    try:
        text = read_text(path)
    except (OSError, JsonError) as error:
        raise DatasetError(
            f"cannot read {path}: {error}; it is written last, so the capture was not finished: capture it again"
        ) from error
    try:
        kind = decode(text, _Kind)
        if kind.format != FORMAT:
            raise DatasetError(f"{path} is a '{kind.format}', expected a '{FORMAT}'")
        if kind.version != VERSION:
            raise DatasetError(
                f"{path} is a capture of version {kind.version}, this program reads version {VERSION}; capture it "
                "again with the add-on that came with this program"
            )
        return decode(text, _Capture)
    except JsonError as error:
        raise DatasetError(f"{path} breaks the format: {error}; capture the scene again") from error


def _identities(root: Path, capture: _Capture) -> tuple[Skeleton, dict[str, Person], dict[str, ObjectShape]]:
    path = root / "capture.json"
    try:
        skeleton = Skeleton(tuple(capture.skeleton.names), tuple(capture.skeleton.parents))
    except SkeletonError as error:
        raise DatasetError(f"{path}: {error}") from error
    persons = {}
    for name in (*capture.persons, *capture.objects):
        check_name(name, path)
    for name, person in capture.persons.items():
        joints = _array(person.rest_joints, (len(skeleton), 3), f"rest_joints of '{name}' in {path}")
        persons[name] = Person(name, joints, _read_surface(root / "persons" / f"{name}.npz", len(skeleton)))
    objects = {}
    for name, shape in capture.objects.items():
        lower, upper = (_array(corner, (3,), f"the box of '{name}' in {path}") for corner in (shape.lower, shape.upper))
        if (lower >= upper).any():
            raise DatasetError(f"the box of '{name}' in {path} is empty: {shape.lower} to {shape.upper}")
        objects[name] = ObjectShape(name, lower, upper)
    return skeleton, persons, objects


def _read_surface(path: Path, bones: int) -> SkinnedSurface | None:
    if not path.is_file():
        return None
    content = _load(path, ("vertices", "weights", "faces"))
    vertices = _array(content["vertices"], (-1, 3), f"vertices of {path}")
    weights = _array(content["weights"], (len(vertices), bones), f"weights of {path}")
    faces = _array(content["faces"], (-1, 3), f"faces of {path}").astype(np.int64)
    if faces.ndim != 2 or faces.shape[1] != 3 or (len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices)):
        raise DatasetError(f"faces of {path} do not fit its {len(vertices)} vertices; expected [T, 3] indices")
    total = weights.sum(1, keepdims=True)
    if (weights < 0).any() or (total <= 0).any():
        raise DatasetError(f"weights of {path} are negative or sum to zero for a vertex; expected rows that sum to one")
    return SkinnedSurface(vertices, weights / total, faces)


def _read_sequence(
    root: Path,
    sequence: _Sequence,
    wanted: frozenset[str] | None,
    identities: tuple[Skeleton, Mapping[str, Person], Mapping[str, ObjectShape]],
    gaps: Counter[str],
) -> list[View]:
    skeleton, persons, objects = identities
    unknown = [name for name in sequence.objects if name not in objects]
    if (sequence.person is not None and sequence.person not in persons) or unknown:
        raise DatasetError(
            f"the sequence '{sequence.name}' in {root} uses '{unknown[0] if unknown else sequence.person}', which "
            "capture.json does not describe; capture it again"
        )
    if not (1 <= sequence.width <= MOST_SIDE and 1 <= sequence.height <= MOST_SIDE):
        raise DatasetError(
            f"the sequence '{sequence.name}' in {root} states {sequence.width}x{sequence.height} pixels, expected 1 to "
            f"{MOST_SIDE} each way; capture it again"
        )
    folder = root / "sequences" / check_name(sequence.name, root / "capture.json")
    for camera_name in sequence.cameras:
        check_name(camera_name, root / "capture.json")
    path = folder / "poses.npz"
    arrays = _load(path, ("frames", "world_from_bone", "world_from_object", "intrinsics", "world_from_camera"))
    frames = _array(arrays["frames"], (-1,), f"frames of {path}").astype(np.int64)
    count, cameras = len(frames), len(sequence.cameras)
    bones = len(skeleton) if sequence.person is not None else -1
    world_from_bone = _rigid(arrays, "world_from_bone", (count, bones), path)
    world_from_object = _rigid(arrays, "world_from_object", (count, len(sequence.objects)), path)
    world_from_camera = _rigid(arrays, "world_from_camera", (cameras, count), path)
    intrinsics = _array(arrays["intrinsics"], (cameras, count, 3, 3), f"intrinsics of {path}")
    names = [f"{frame:04d}" for frame in frames]
    if wanted is not None:
        gaps.update(["frame"] * len(wanted - set(names)))
    views = []
    for index, name in enumerate(names):
        if wanted is not None and name not in wanted:
            continue
        pose = Pose(sequence.person, tuple(sequence.objects), world_from_bone[index], world_from_object[index])
        for number, camera_name in enumerate(sequence.cameras):
            try:
                camera = Camera(
                    intrinsics[number, index], world_from_camera[number, index], sequence.width, sequence.height
                )
            except CameraError as error:
                raise DatasetError(f"{path}: camera '{camera_name}' in frame {name}: {error}") from error
            files = _files(folder / name, camera_name, sequence, gaps)
            if files is not None:
                views.append(View(sequence.name, name, camera_name, camera, pose, *files))
    return views


def _files(
    folder: Path, camera: str, sequence: _Sequence, gaps: Counter[str]
) -> tuple[Path, Path | None, Path | None] | None:
    """Image, person mask and object mask; a part the sequence does not have needs no mask."""
    image, person, thing = (folder / f"{camera}.{name}.png" for name in ("color", "person_mask", "object_mask"))
    needed = {"image": image}
    if sequence.person is not None:
        needed["person mask"] = person
    if sequence.objects:
        needed["object mask"] = thing
    missing = [kind for kind, path in needed.items() if not path.is_file()]
    gaps.update(missing)
    return None if missing else (image, needed.get("person mask"), needed.get("object mask"))


def _load(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    try:
        return read_arrays(path, names)
    except (OSError, ArraysError) as error:
        raise DatasetError(
            f"cannot read {path}: {error}; expected arrays {', '.join(names)}, capture the sequence again"
        ) from error


def _array(values: object, shape: tuple[int, ...], name: str) -> np.ndarray:
    """float64 values of a shape (-1: any length), all finite."""
    try:
        array = real_numbers(values)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{name}: {error}; expected numbers in the shape {shape}") from error
    fits = array.ndim == len(shape) and all(want in (-1, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits:
        raise DatasetError(f"{name} has the shape {array.shape}, expected {shape}")
    if not (np.abs(array) <= FARTHEST).all():
        raise DatasetError(f"{name} holds values that are not finite, or beyond {FARTHEST:g}; capture the scene again")
    return array


def _rigid(arrays: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    matrices = _array(arrays[name], (*shape, 4, 4), f"{name} of {path}")
    rotation = matrices[..., :3, :3]
    last = np.abs(matrices[..., 3, :] - (0.0, 0.0, 0.0, 1.0)).max(initial=0.0)
    error = max(last, np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(initial=0.0))
    if error > RIGID_TOLERANCE or (np.linalg.det(rotation) < 0).any():
        raise DatasetError(
            f"{name} of {path} holds scaled, sheared or mirrored matrices (by up to {error:.3g}); capture it again"
        )
    return matrices

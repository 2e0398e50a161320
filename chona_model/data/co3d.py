"""Reader of CO3D's layout (version 2): one static object a sequence, filmed by a phone that moves around it.

::

    <category>/frame_annotations.jgz, sequence_annotations.jgz     gzipped JSON
               set_lists/set_lists_manyview_dev_0.json             {"train": [[sequence, frame number, path], …], …}
               <sequence>/images, masks, pointcloud.ply

What CO3D means, and what is done here: cameras are PyTorch3D's, ``x_cam = x_world R + T`` with x left, y up, z forward,
and focal lengths and principal points in NDC; pixel centres are at +0.5 in both.  The world's origin, orientation and
scale are arbitrary: they are set as ``placing.py`` says.  ``--split FILE:KEY`` reads CO3D's own set lists.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from chona_model.camera import Camera, CameraError, is_rotation, rigid
from chona_model.data.behave_objects import read_ply_vertices
from chona_model.data.dataset import Dataset, DatasetError, View
from chona_model.data.packed_json import read_packed
from chona_model.data.paths import check_name, named_file
from chona_model.data.placing import LONGEST_SIDE, STRAYS, hull_points, place, static_pose
from chona_model.data.reading import chosen_frames, counted
from chona_model.skeleton import SMPL

FRAMES, SEQUENCES = "frame_annotations.jgz", "sequence_annotations.jgz"
MIN_VIEWPOINT_QUALITY = 0.5
"""Sequences with a lower score have cameras that do not fit their pictures; one that is named is read all the same."""
RAY_SHARE = 0.25
"""512 rays of an image where BEHAVE's have 2048 (paper, section 4)."""
OPENCV_FROM_PYTORCH3D = np.diag([-1.0, -1.0, 1.0])


class _Image(msgspec.Struct):
    path: str
    size: tuple[int, int]


class _Mask(msgspec.Struct):
    path: str


class _Viewpoint(msgspec.Struct):
    R: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    T: tuple[float, float, float]
    focal_length: tuple[float, float]
    principal_point: tuple[float, float]
    intrinsics_format: str = "ndc_norm_image_bounds"


class _Frame(msgspec.Struct):
    sequence_name: str
    frame_number: int
    image: _Image
    mask: _Mask | None = None
    viewpoint: _Viewpoint | None = None


class _Cloud(msgspec.Struct):
    path: str


class _Sequence(msgspec.Struct):
    sequence_name: str
    category: str
    point_cloud: _Cloud | None = None
    viewpoint_quality_score: float | None = None


@dataclass(frozen=True)
class _Chosen:
    """One wanted sequence; ``frames`` None stands for all."""

    folder: Path
    sequence: _Sequence
    frames: frozenset[str] | None

    @property
    def identity(self) -> str:
        """Every sequence of CO3D shows another object: its name is the category's and its own."""
        return f"{self.sequence.category}_{self.sequence.sequence_name}"


def read_co3d(root: Path, sequences: Sequence[str] | None = None, object_size: float | None = None) -> Dataset:
    """Reads sequences of a folder in CO3D's layout.

    Args:
        root: the folder with the categories, or one category's.
        sequences: names of categories or sequences, or ``SEQUENCE/FRAME`` (``70_5774_13292/12``); all when None.
        object_size: metres of every object's longest side; ``LONGEST_SIDE`` when None.

    Raises:
        DatasetError: no annotations, no such sequence, cameras of an unknown format, or nothing usable.
    """
    gaps: Counter[str] = Counter()
    wanted = _chosen(category_folders(root), sequences, root, gaps)
    frames: dict[Path, list[_Frame]] = {}
    views: list[View] = []
    objects = {}
    for chosen in wanted:
        if chosen.folder not in frames:
            frames[chosen.folder] = read_packed(chosen.folder / FRAMES, list[_Frame], "CO3D's frame annotations")
        own = [frame for frame in frames[chosen.folder] if frame.sequence_name == chosen.sequence.sequence_name]
        # The whole sequence says where the object is, whichever of its frames are wanted.
        found = _views(chosen, own, gaps)
        if not found:
            continue
        cameras = [view.camera for view in found]
        cloud = _cloud(chosen, gaps)
        points, strays = (hull_points(found), 0.0) if cloud is None else (cloud, STRAYS)
        placing = place(cameras, points, object_size or LONGEST_SIDE, strays)
        objects[chosen.identity] = placing.shape(chosen.identity)
        if chosen.frames is not None:
            gaps["frame"] += len(chosen.frames - {view.frame for view in found})
            found = [view for view in found if view.frame in chosen.frames]
        views.extend(replace(view, camera=placing.camera(view.camera)) for view in found)
    if not views:
        raise DatasetError(f"{root} has no view with an image, a mask and a camera (missing: {counted(gaps)})")
    seen = {view.pose.objects[0] for view in views}
    return Dataset(SMPL, {}, {name: objects[name] for name in objects if name in seen}, tuple(views), +gaps)


def category_folders(root: Path) -> list[Path]:
    """Folders with annotations: ``root``, or those in ``root`` or ``root/co3d``."""
    if (root / FRAMES).is_file():
        return [root]
    for parent in (root, root / "co3d"):
        found = sorted(path.parent for path in parent.glob(f"*/{FRAMES}"))
        if found:
            return found
    return []


def _chosen(folders: Sequence[Path], wanted: Sequence[str] | None, root: Path, gaps: Counter[str]) -> list[_Chosen]:
    if not folders:
        raise DatasetError(f"{root} has no category of CO3D; expected CATEGORY/{FRAMES} and CATEGORY/{SEQUENCES}")
    known: dict[str, tuple[Path, _Sequence]] = {}
    by_category: dict[str, list[str]] = defaultdict(list)
    for folder in folders:
        for sequence in read_packed(folder / SEQUENCES, list[_Sequence], "CO3D's sequence annotations"):
            check_name(f"{sequence.category}_{sequence.sequence_name}", folder / SEQUENCES)
            known[sequence.sequence_name] = (folder, sequence)
            by_category[sequence.category].append(sequence.sequence_name)
    asked: list[str] = []
    for entry in wanted if wanted is not None else by_category:
        name = entry.partition("/")[0]
        if name in by_category:
            asked.extend(each for each in by_category[name] if _good(known[each][1], gaps))
        elif name in known:
            asked.append(entry)
        else:
            raise DatasetError(f"there is no sequence or category '{name}' in {root}; it has {_some(known)}")
    return [_Chosen(*known[name], frames) for name, frames in chosen_frames(known, asked, "sequence", root).items()]


def _good(sequence: _Sequence, gaps: Counter[str]) -> bool:
    score = sequence.viewpoint_quality_score
    if score is None or score >= MIN_VIEWPOINT_QUALITY:
        return True
    gaps["sequence with good cameras"] += 1
    return False


def _some(names: Mapping[str, object]) -> str:
    shown = list(names)[:10]
    return ", ".join(shown) + (f" and {len(names) - len(shown)} more" if len(names) > len(shown) else "")


def _views(chosen: _Chosen, frames: Sequence[_Frame], gaps: Counter[str]) -> list[View]:
    """Views in the scan's own world."""
    pose = static_pose(chosen.identity)
    views = []
    for frame in frames:
        image, mask = (
            _file(chosen.folder, part.path if part is not None else None) for part in (frame.image, frame.mask)
        )
        missing = [
            kind
            for kind, part in (("image", image), ("object mask", mask), ("camera", frame.viewpoint))
            if part is None
        ]
        gaps.update(missing)
        if image is None or frame.viewpoint is None or missing:
            continue
        name = str(frame.frame_number)
        views.append(
            View(
                chosen.sequence.sequence_name, name, "phone", _camera(frame, chosen.folder), pose, image,
                object_mask=mask, ray_share=RAY_SHARE,
            )
        )  # fmt: skip
    return views


def _file(folder: Path, path: str | None) -> Path | None:
    """Paths begin with the category; None for none and for what is not there.

    Raises:
        DatasetError: the path leads out of the data set.
    """
    if path is None:
        return None
    source = f"a file of annotations in {folder}"
    own = named_file(folder.parent, path, source)
    return own or named_file(folder, "/".join(Path(path).parts[1:]), source)


def _camera(frame: _Frame, folder: Path) -> Camera:
    """OpenCV's from PyTorch3D's."""
    viewpoint, (height, width) = frame.viewpoint, frame.image.size
    assert viewpoint is not None
    if viewpoint.intrinsics_format == "ndc_isotropic":
        half = np.full(2, 0.5 * min(width, height))
    elif viewpoint.intrinsics_format == "ndc_norm_image_bounds":
        half = 0.5 * np.array([width, height], dtype=np.float64)
    else:
        raise DatasetError(
            f"{folder / FRAMES}: frame {frame.frame_number} of {frame.sequence_name} has the intrinsics_format "
            f"'{viewpoint.intrinsics_format}', expected ndc_isotropic or ndc_norm_image_bounds"
        )
    focal = np.array(viewpoint.focal_length) * half
    centre = 0.5 * np.array([width, height]) - np.array(viewpoint.principal_point) * half
    camera_from_world = OPENCV_FROM_PYTORCH3D @ np.array(viewpoint.R).T
    origin = -camera_from_world.T @ OPENCV_FROM_PYTORCH3D @ np.array(viewpoint.T)
    try:
        if not is_rotation(camera_from_world):
            raise CameraError("R is not a rotation (to 0.001)")
        intrinsics = np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])
        return Camera(intrinsics, rigid(camera_from_world.T, origin), width, height)
    except CameraError as error:
        raise DatasetError(
            f"{folder / FRAMES}: the camera of frame {frame.frame_number} of {frame.sequence_name}: {error}"
        ) from error


def _cloud(chosen: _Chosen, gaps: Counter[str]) -> np.ndarray | None:
    """[P, 3] the object's point cloud in the scan's world; None, counted, where there is none."""
    cloud = chosen.sequence.point_cloud
    path = _file(chosen.folder, cloud.path if cloud is not None else None)
    if path is not None:
        return read_ply_vertices(path)
    gaps["point cloud"] += 1
    return None

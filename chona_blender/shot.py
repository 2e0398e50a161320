"""Writes a shot (docs/file-formats.md): cameras and actors over a frame range, with numpy alone."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bpy.types import Object, Scene

from .camera import image_format
from .errors import ChonaError
from .model_header import ModelHeader
from .rig.mapping import bone_mapping
from .rig.rest_pose import model_rest_pose
from .rig.sampling import Progress, check_armature, frame_list, rescale_camera, rigid_pose, sample, stored_overrides
from .rig.validation import STRETCH_LIMIT, Dropped

SUFFIX = ".shot.npz"
_RESERVED = frozenset('/\\:*?"<>|\0')


@dataclass(frozen=True)
class Shot:
    """A sampled shot, not yet written.

    Attributes:
        header: what the file's JSON header holds.
        arrays: the file's arrays without the header.
        dropped: scale and shear that was dropped, the worst first.
    """

    header: dict[str, Any]
    arrays: dict[str, np.ndarray]
    dropped: tuple[Dropped, ...]


def sample_shot(
    scene: Scene,
    armature: Object | None,
    empties: Mapping[str, Object | None],
    person: str | None,
    object_names: Sequence[str],
    frames: Iterable[int],
    header: ModelHeader,
    name: str = "shot",
    overrides: Mapping[str, str] | None = None,
    *,
    limit: float = STRETCH_LIMIT,
    progress: Progress | None = None,
) -> Shot:
    """Samples one actor and the scene's cameras.

    A figure that is scaled as a whole (a giant, a doll) is written in natural size with the world divided by its scale,
    which gives the same picture; the array ``world_scale`` says by how much depths are to be multiplied.

    Args:
        armature: poses ``person``; may be None where ``person`` is.
        empties: places the objects, by the model's names.
        frames: scene frames; sorted, repetitions dropped.
        name: of the shot, it starts the names of the baked files.
        overrides: bone mapping chosen by the user, model bone → armature bone.
        limit: stretch of a bone that is dropped, more is refused.

    Raises:
        ChonaError: no camera, no frames, no armature, an object without an empty, bones that map to nothing, matrices
            that cannot be made rigid, a panoramic camera.
    """
    numbers = frame_list(frames)
    if not name or name != name.strip() or name.startswith(".") or _RESERVED & set(name):
        raise ChonaError(f"The shot is called '{name}', which cannot start the name of a file. Choose another name")
    image = image_format(scene)
    placed = _placed(empties, object_names, header)
    bones: list[str] = []
    rest = None
    if person is not None:
        joints = header.rest_joints(person)
        if armature is None:
            raise ChonaError(f"Person '{person}' has no armature. Create a rig for it or choose an armature")
        mapping = bone_mapping(
            check_armature(armature), header.names, {**stored_overrides(armature), **(overrides or {})}
        )
        bones = list(mapping.values())
        rest = model_rest_pose(armature, bones, joints)
    elif not placed:
        raise ChonaError("The shot has neither a person nor an object. Choose a person, an object or both")
    samples = sample(scene, armature if rest else None, bones, placed, frames=numbers, image=image, progress=progress)
    pose = rigid_pose(samples, rest, header.names, object_names, limit=limit, object_limit=limit)
    cameras = [rescale_camera(row[0], pose.scale) for row in samples.cameras]
    kinds = sorted({camera.kind for camera in cameras})
    if len(kinds) > 1:
        raise ChonaError(
            "The frame range switches between perspective and orthographic cameras. Write one shot for each, with its "
            "own frame range"
        )
    description = {
        "format": "chona-shot",
        "version": 1,
        "name": name,
        "fps": scene.render.fps / scene.render.fps_base,
        "width": image.width,
        "height": image.height,
        "camera_kind": kinds[0],
        "actors": [
            {
                "name": armature.name if armature is not None and rest else person or "objects",
                "person": person,
                "objects": list(object_names),
                "bones": list(header.names) if rest else [],
            }
        ],
    }
    arrays = {
        "frames": numbers,
        "camera.intrinsics": np.stack([camera.intrinsics for camera in cameras]),
        "camera.world_from_camera": np.stack([camera.world_from_camera for camera in cameras]),
        "camera.clip": np.stack([camera.clip for camera in cameras]),
        "actor.0.world_from_bone": pose.world_from_bone,
        "actor.0.world_from_object": pose.world_from_object,
    }
    if pose.scale != 1.0:
        arrays["world_scale"] = np.array(pose.scale)
    return Shot(description, arrays, pose.dropped)


def _placed(empties: Mapping[str, Object | None], object_names: Sequence[str], header: ModelHeader) -> list[Object]:
    placed = []
    for each in object_names:
        header.extents(each)
        empty = empties.get(each)
        if empty is None:
            raise ChonaError(f"Object '{each}' has no empty. Create a rig with it or choose an empty for it")
        placed.append(empty)
    return placed


def save_shot(path: str | Path, shot: Shot) -> Path:
    """Writes a shot under a temporary name and renames it; ``.shot.npz`` is appended where it is missing.

    Raises:
        ChonaError: the folder cannot be written to.
    """
    path = shot_path(path)
    text = np.frombuffer(json.dumps(shot.header).encode("utf-8"), dtype=np.uint8)
    write_npz(path, {"header": text, **shot.arrays})
    return path


def shot_path(path: str | Path) -> Path:
    """``path`` with the suffix ``.shot.npz``."""
    path = Path(path)
    return path if path.name.endswith(SUFFIX) else path.with_name(path.name.removesuffix(".npz") + SUFFIX)


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes arrays under a temporary name beside ``path`` and renames: a reader never sees half a file.

    Raises:
        ChonaError: the folder cannot be written to.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)
        Path(temporary).replace(path)
        temporary = None
    except OSError as error:
        raise ChonaError(f"'{path}' cannot be written ({error.strerror}). Choose another folder") from error
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


def write_shot(
    path: str | Path,
    scene: Scene,
    armature: Object | None,
    empties: Mapping[str, Object | None],
    person: str | None,
    object_names: Sequence[str],
    frames: Iterable[int],
    header: ModelHeader,
    name: str | None = None,
    overrides: Mapping[str, str] | None = None,
    *,
    limit: float = STRETCH_LIMIT,
    progress: Progress | None = None,
) -> Path:
    """Samples a shot and writes it; see ``sample_shot`` for arguments and errors.

    Args:
        name: default the file's name without its suffix.

    Returns:
        the file that was written.
    """
    path = shot_path(path)
    name = name or path.name.removesuffix(SUFFIX)
    shot = sample_shot(
        scene, armature, empties, person, object_names, frames, header, name, overrides, limit=limit, progress=progress
    )
    return save_shot(path, shot)

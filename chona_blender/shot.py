"""Samples a shot: cameras and actors over a frame range, or as they are now."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bpy.types import Depsgraph, Object, Scene

from .camera import ImageFormat, image_format
from .errors import ChonaError
from .model_header import ModelHeader
from .rig.mapping import bone_mapping
from .rig.rest_pose import RestPose, model_rest_pose
from .rig.rigid import rescale_camera, rigid_pose
from .rig.sampling import Progress, Samples, check_armature, frame_list, sample, sample_now, stored_overrides
from .rig.validation import STRETCH_LIMIT
from .shot_file import SUFFIX, Shot, save_shot, shot_path

_RESERVED = frozenset('/\\:*?"<>|\0')


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
    cast = _cast(armature, empties, person, object_names, header, overrides)
    image = image_format(scene)
    samples = sample(scene, cast.armature, cast.bones, cast.placed, frames=numbers, image=image, progress=progress)
    return _shot(scene, cast, samples, image, name, limit)


def sample_shot_now(
    scene: Scene,
    depsgraph: Depsgraph,
    armature: Object | None,
    empties: Mapping[str, Object | None],
    person: str | None,
    object_names: Sequence[str],
    header: ModelHeader,
    *,
    limit: float = STRETCH_LIMIT,
) -> Shot:
    """A shot of one frame: the actor and the scene's camera as they are now, edits without a key included.

    Args:
        depsgraph: evaluated, of a view layer of ``scene``; for the others see ``sample_shot``.

    Raises:
        ChonaError: see ``sample_shot``; also what the view layer does not evaluate.
    """
    cast = _cast(armature, empties, person, object_names, header, None)
    image = image_format(scene)
    samples = sample_now(scene, depsgraph, cast.armature, cast.bones, cast.placed, image)
    return _shot(scene, cast, samples, image, "live", limit)


@dataclass(frozen=True)
class _Cast:
    """An actor whose parts have been found: ``bones`` of the armature for the model's, an object for each empty."""

    person: str | None
    armature: Object | None
    bones: list[str]
    rest: RestPose | None
    object_names: Sequence[str]
    placed: list[Object]
    header: ModelHeader


def _cast(
    armature: Object | None,
    empties: Mapping[str, Object | None],
    person: str | None,
    object_names: Sequence[str],
    header: ModelHeader,
    overrides: Mapping[str, str] | None,
) -> _Cast:
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
    return _Cast(person, armature if rest else None, bones, rest, object_names, placed, header)


def _shot(scene: Scene, cast: _Cast, samples: Samples, image: ImageFormat, name: str, limit: float) -> Shot:
    names, object_names = cast.header.names, cast.object_names
    pose = rigid_pose(samples, cast.rest, names, object_names, limit=limit, object_limit=limit)
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
                "name": cast.armature.name if cast.armature is not None else cast.person or "objects",
                "person": cast.person,
                "objects": list(object_names),
                "bones": list(names) if cast.rest else [],
            }
        ],
    }
    arrays = {
        "frames": samples.frames,
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

"""Samples a shot: cameras and actors over a frame range, or as they are now."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from bpy.types import Depsgraph, Object, Scene

from .blur import LensSample, SceneBlur
from .camera import CameraSample, ImageFormat, image_format
from .errors import ChonaError
from .model_header import ModelHeader
from .rig.cast import ActorPlan, Cast, cast, unique_labels
from .rig.rigid import RigidPose, objects_pose, rescale_camera
from .rig.sampling import Progress, Samples, frame_list, sample_all, sample_now
from .rig.validation import STRETCH_LIMIT, figure_scale
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
    plan = ActorPlan(header, person, armature, {each: empties.get(each) for each in object_names}, overrides or {})
    return sample_actors(scene, [plan], frames, name, limit=limit, progress=progress)


def sample_actors(
    scene: Scene,
    plans: Sequence[ActorPlan],
    frames: Iterable[int],
    name: str = "shot",
    *,
    limit: float = STRETCH_LIMIT,
    progress: Progress | None = None,
    blur: SceneBlur | None = None,
) -> Shot:
    """Samples any number of actors and the scene's cameras in one pass; see ``sample_shot``.

    Args:
        blur: motion blur and depth of field to take along; None: frames are sharp.

    Raises:
        ChonaError: see ``sample_shot``; also two actors whose figures are scaled differently.
    """
    numbers = frame_list(frames)
    if not name or name != name.strip() or name.startswith(".") or _RESERVED & set(name):
        raise ChonaError(f"The shot is called '{name}', which cannot start the name of a file. Choose another name")
    found = [cast(plan) for plan in plans]
    image = image_format(scene)
    moments = (0.0, *(() if blur is None else blur.times))
    samples = sample_all(
        scene, [each.subject for each in found], frames=numbers, image=image, moments=moments, progress=progress
    )
    return _shot(scene, found, samples, image, name, limit, blur=blur)


def sample_actors_now(
    scene: Scene,
    depsgraph: Depsgraph,
    plans: Sequence[ActorPlan],
    served: Path | None = None,
    *,
    limit: float = STRETCH_LIMIT,
) -> Shot:
    """A shot of one frame: actors and the scene's camera as they are now, edits without a key included.

    Args:
        depsgraph: evaluated, of a view layer of ``scene``; for the others see ``sample_actors``.
        served: the model of the worker that gets the shot; actors of others name theirs. None: the first actor's.

    Raises:
        ChonaError: see ``sample_actors``; also what the view layer does not evaluate.
    """
    found = [cast(plan) for plan in plans]
    image = image_format(scene)
    samples = sample_now(scene, depsgraph, [each.subject for each in found], image)
    return _shot(scene, found, samples, image, "live", limit, served)


def _poses(found: Sequence[Cast], samples: Sequence[Samples], labels: Sequence[str], limit: float) -> list[RigidPose]:
    """Every actor's pose, in one common scale: people's own; objects alone follow them."""
    poses: list[RigidPose | None] = [
        each.driver.pose(taken, each.object_names, limit=limit, object_limit=limit) if each.driver else None
        for each, taken in zip(found, samples, strict=True)
    ]
    sizes = {label: pose.scale for label, pose in zip(labels, poses, strict=True) if pose is not None}
    scale = next(iter(sizes.values()), 0.0)
    for label, size in sizes.items():
        if abs(size / scale - 1.0) > 1e-3:
            first = next(iter(sizes))
            raise ChonaError(
                f"'{first}' is {scale:.3g} times its natural size and '{label}' {size:.3g} times. Actors of one shot "
                "need one size: scale their armatures alike, or bake them as two shots"
            )
    for index, taken in enumerate(samples):
        if poses[index] is None:
            linear = taken.world_from_object[..., :3, :3]
            own = scale or (figure_scale(linear) if np.isfinite(linear).all() else 1.0) or 1.0
            placed, dropped = objects_pose(taken, found[index].object_names, own, limit)
            scale = scale or own
            poses[index] = RigidPose(np.empty((len(taken.frames), 0, 4, 4)), placed, own, tuple(dropped))
    return [pose for pose in poses if pose is not None]


def _shot(
    scene: Scene,
    found: Sequence[Cast],
    samples: Sequence[Samples],
    image: ImageFormat,
    name: str,
    limit: float,
    served: Path | None = None,
    blur: SceneBlur | None = None,
) -> Shot:
    if not found:
        raise ChonaError("The shot has no actor. Choose a person, an object or both")
    labels = unique_labels([each.plan for each in found])
    poses = _poses(found, samples, labels, limit)
    scale = poses[0].scale
    cameras = [rescale_camera(row[0], scale) for row in samples[0].cameras]
    kinds = sorted({camera.kind for camera in cameras})
    if len(kinds) > 1:
        raise ChonaError(
            "The frame range switches between perspective and orthographic cameras. Write one shot for each, with its "
            "own frame range"
        )
    models = [each.plan.header.path.absolute() for each in found]
    first = models[0] if served is None else served.absolute()
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
                "name": label,
                "person": each.plan.person,
                "objects": list(each.object_names),
                "bones": list(each.plan.header.names) if each.driver else [],
                **({"model": str(model)} if model != first else {}),
            }
            for each, label, model in zip(found, labels, models, strict=True)
        ],
    }
    moments = 1 if blur is None else 1 + len(blur.times)
    own = slice(None, None, moments)
    arrays = {
        "frames": samples[0].frames[own],
        "camera.intrinsics": np.stack([camera.intrinsics for camera in cameras[own]]),
        "camera.world_from_camera": np.stack([camera.world_from_camera for camera in cameras[own]]),
        "camera.clip": np.stack([camera.clip for camera in cameras[own]]),
    }
    for index, pose in enumerate(poses):
        arrays[f"actor.{index}.world_from_bone"] = pose.world_from_bone[own]
        arrays[f"actor.{index}.world_from_object"] = pose.world_from_object[own]
    if blur is not None:
        arrays |= _blur_arrays(blur, poses, cameras, samples[0].frames)
    if scale != 1.0:
        arrays["world_scale"] = np.array(scale)
    return Shot(description, arrays, tuple(dropped for pose in poses for dropped in pose.dropped))


def _blur_arrays(
    blur: SceneBlur, poses: Sequence[RigidPose], cameras: Sequence[CameraSample], frames: np.ndarray
) -> dict[str, np.ndarray]:
    """What the file holds besides where something can blur; of all moments of all frames, the frame's own first.

    Raises:
        ChonaError: a camera focuses on its own place.
    """
    moments, arrays = 1 + len(blur.times), {}

    def open_shutter(array: np.ndarray) -> np.ndarray:
        return array.reshape(len(array) // moments, moments, *array.shape[1:])[:, 1:]

    if moments > 1:
        arrays["shutter.times"] = blur.times
        arrays["shutter.intrinsics"] = open_shutter(np.stack([camera.intrinsics for camera in cameras]))
        arrays["shutter.world_from_camera"] = open_shutter(np.stack([camera.world_from_camera for camera in cameras]))
        for index, pose in enumerate(poses):
            arrays[f"shutter.actor.{index}.world_from_bone"] = open_shutter(pose.world_from_bone)
            arrays[f"shutter.actor.{index}.world_from_object"] = open_shutter(pose.world_from_object)
    lenses = [camera.lens for camera in cameras[::moments]]
    for lens, frame in zip(lenses, frames[::moments], strict=True):
        if blur.lens and lens.radius > 0.0 and not lens.focus_distance > 0.0:
            raise ChonaError(
                f"The camera focuses on its own place in frame {frame}. Set its focus distance, or switch its depth of "
                "field off"
            )
    if blur.lens and any(lens.radius > 0.0 for lens in lenses):
        for field in fields(LensSample):
            arrays[f"lens.{field.name}"] = np.array([getattr(lens, field.name) for lens in lenses], dtype=np.float64)
    return {**arrays, "blur.samples": np.array(blur.samples, dtype=np.int64)} if arrays else {}


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

"""Poses and cameras over a frame range, from the evaluated depsgraph of a temporary scene.

Only rig, objects and cameras are linked to it (what they depend on is evaluated with them), so a heavy scene costs
nothing, constraints, IK and drivers count, and the user's frame, selection and un-keyed edits stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import Object, Scene

from ..camera import CameraSample, ImageFormat, sample_camera, scene_camera
from ..errors import ChonaError
from .rest_pose import RestPose
from .validation import STRETCH_LIMIT, Dropped, figure_scale, project_rotations

Progress = Callable[[int, int, str], None]
"""Called with frames done, frames in all, and what is being done; may raise to stop."""


@dataclass(frozen=True)
class Samples:
    """Blender's own matrices, as they are: they may scale and shear.

    Attributes:
        frames: [F] int64.
        world_from_armature: [F, B, 4, 4] where each bone takes the armature's rest space in the world.
        world_from_object: [F, N, 4, 4] evaluated object matrices.
        cameras: F tuples of C cameras.
    """

    frames: np.ndarray
    world_from_armature: np.ndarray
    world_from_object: np.ndarray
    cameras: tuple[tuple[CameraSample, ...], ...]


@dataclass(frozen=True)
class RigidPose:
    """Rigid frames as in docs/conventions.md, in metres of the *figure*: Blender's world divided by ``scale``.

    Attributes:
        world_from_bone: [F, B, 4, 4].
        world_from_object: [F, N, 4, 4].
        scale: the figure's uniform scale; 1 for a figure of natural size.
        dropped: scale and shear that was dropped, a bone or object each, the worst first.
    """

    world_from_bone: np.ndarray
    world_from_object: np.ndarray
    scale: float
    dropped: tuple[Dropped, ...]


def frame_list(frames: Iterable[int]) -> np.ndarray:
    """Increasing frame numbers [F] int64 without repetition.

    Raises:
        ChonaError: there are none.
    """
    unique = np.array(sorted({int(frame) for frame in frames}), dtype=np.int64)
    if not unique.size:
        raise ChonaError("The frame range is empty. Choose a last frame that is not before the first")
    return unique


def check_armature(armature: Object | None) -> Object:
    """The armature, ready to be sampled.

    Raises:
        ChonaError: none, another kind of object, being edited, or shown in its rest position.
    """
    if armature is None:
        raise ChonaError("There is no armature. Create a rig for the model or choose an armature")
    if armature.type != "ARMATURE":
        raise ChonaError(f"'{armature.name}' is a {armature.type.lower()}, expected an armature. Choose an armature")
    if armature.mode == "EDIT":
        raise ChonaError(f"Armature '{armature.name}' is being edited. Leave edit mode first")
    if armature.data.pose_position == "REST":
        raise ChonaError(
            f"Armature '{armature.name}' shows its rest position. Set it to Pose Position in its data properties"
        )
    return armature


@contextmanager
def evaluation_scene(scene: Scene, objects: Iterable[Object]) -> Iterator[Scene]:
    """A temporary scene with nothing but ``objects``, timed like ``scene``; removed afterwards."""
    temporary = bpy.data.scenes.new("CHONA sampling")
    try:
        for name in ("fps", "fps_base", "frame_map_old", "frame_map_new"):
            setattr(temporary.render, name, getattr(scene.render, name))
        temporary.unit_settings.scale_length = scene.unit_settings.scale_length
        for each in dict.fromkeys(objects):
            temporary.collection.objects.link(each)
        yield temporary
    finally:
        bpy.data.scenes.remove(temporary)


def _refuse_simulated(scene: Scene, objects: Sequence[Object]) -> None:
    world = scene.rigidbody_world
    for each in objects:
        body = each.rigid_body
        if world and world.enabled and body and body.type == "ACTIVE" and not body.kinematic:
            raise ChonaError(
                f"'{each.name}' is moved by the rigid body simulation, which is not sampled. Bake it to keyframes "
                "first (Object > Rigid Body > Bake to Keyframes)"
            )


def sample(
    scene: Scene,
    armature: Object | None,
    bones: Sequence[str],
    objects: Sequence[Object],
    *,
    frames: Iterable[int],
    image: ImageFormat | None = None,
    cameras: Sequence[Object] | None = None,
    progress: Progress | None = None,
) -> Samples:
    """Samples bones, objects and cameras in one pass over the frames.  Not to be called while drawing.

    Args:
        scene: whose timing (and, with ``cameras`` None, whose camera and markers) count.
        armature: None for objects alone; ``bones`` must be empty then.
        bones: B bone names of the armature.
        objects: N objects (usually empties).
        image: the pixels cameras are sampled for; None samples no camera.
        cameras: C cameras; None takes the one the scene renders each frame with.

    Raises:
        ChonaError: no frames, an armature that cannot be sampled, a camera that cannot be rendered.
    """
    numbers = frame_list(frames)
    if armature is not None or bones:
        armature = check_armature(armature)
    _refuse_simulated(scene, objects)
    chosen: list[tuple[Object, ...]] = [()] * len(numbers)
    if image is not None:
        chosen = [tuple(cameras) if cameras is not None else (scene_camera(scene, int(n)),) for n in numbers]
    linked = [*objects, *(each for row in chosen for each in row)] + ([armature] if armature else [])
    posed = np.empty((len(numbers), len(bones), 4, 4))
    placed = np.empty((len(numbers), len(objects), 4, 4))
    rows: list[tuple[CameraSample, ...]] = []
    rest = np.array([armature.data.bones[name].matrix_local for name in bones], dtype=np.float64) if armature else None
    bone_from_rest = np.linalg.inv(rest) if rest is not None and len(rest) else np.empty((0, 4, 4))
    with evaluation_scene(scene, linked) as temporary:
        for index, number in enumerate(numbers):
            temporary.frame_set(int(number))
            depsgraph = temporary.view_layers[0].depsgraph
            if armature is not None:
                evaluated = armature.evaluated_get(depsgraph)
                pose = evaluated.pose.bones
                world = np.array(evaluated.matrix_world, dtype=np.float64)
                local = np.array([pose[name].matrix for name in bones], dtype=np.float64).reshape(-1, 4, 4)
                posed[index] = world @ local @ bone_from_rest
            for slot, each in enumerate(objects):
                placed[index, slot] = np.array(each.evaluated_get(depsgraph).matrix_world)
            rows.append(tuple(sample_camera(each, depsgraph, image) for each in chosen[index]) if image else ())
            if progress is not None:
                progress(index + 1, len(numbers), f"sampled frame {number}")
    return Samples(numbers, posed, placed, tuple(rows))


def rigid_pose(
    samples: Samples,
    rest: RestPose | None,
    names: Sequence[str],
    object_names: Sequence[str],
    *,
    limit: float | None = STRETCH_LIMIT,
    object_limit: float | None = STRETCH_LIMIT,
) -> RigidPose:
    """Rigid bone and object frames of sampled matrices.

    The canonical frame of a bone is a pure translation to its rest joint, so ``world_from_bone`` takes the rotation of
    ``world_from_armature`` after the rest pose's axes, and its position is where the bone's head is.

    Args:
        rest: of the armature the bones were sampled from; None without an armature.
        names, object_names: for messages; the model's bone names and objects.
        limit, object_limit: largest stretch that is dropped; None drops any.

    Raises:
        ChonaError: not finite, zero scale, mirrored, or stretched past the limit, by name and frame.
    """
    frames = samples.frames
    empty = np.empty((len(frames), 0, 4, 4))
    linear = samples.world_from_object[..., :3, :3]
    dropped: list[Dropped] = []
    if rest is not None and rest.bones:
        bones = samples.world_from_armature[..., :3, :3] @ (rest.rotation * rest.scale)
        scale = figure_scale(bones) if np.isfinite(bones).all() else 1.0
        rotations, dropped = project_rotations(
            bones, scale if scale > 0 else 1.0, "Bone", names=names, frames=frames, limit=limit
        )
        heads = np.einsum("fbij,bj->fbi", samples.world_from_armature[..., :3, :3], rest.heads)
        world_from_bone = _homogeneous(rotations, (heads + samples.world_from_armature[..., :3, 3]) / scale)
    else:
        scale = figure_scale(linear) if np.isfinite(linear).all() else 1.0
        scale = scale if scale > 0 and object_limit is not None else 1.0
        world_from_bone = empty
    rotations, more = project_rotations(linear, scale, "Object", names=object_names, frames=frames, limit=object_limit)
    world_from_object = _homogeneous(rotations, samples.world_from_object[..., :3, 3] / scale)
    for name, array in (("bone", world_from_bone), ("object", world_from_object)):
        if not np.isfinite(array).all():
            raise ChonaError(f"The position of a {name} is not finite. Check constraints and drivers")
    return RigidPose(world_from_bone, world_from_object, scale, (*dropped, *more))


def rescale_camera(sample: CameraSample, scale: float) -> CameraSample:
    """The same view of a world that is divided by ``scale``."""
    matrix, intrinsics = sample.world_from_camera.copy(), sample.intrinsics.copy()
    matrix[:3, 3] /= scale
    if sample.kind == "ORTHO":
        intrinsics[[0, 1], [0, 1]] *= scale
    return CameraSample(intrinsics, matrix, sample.clip / scale, sample.kind)


def _homogeneous(rotations: np.ndarray, positions: np.ndarray) -> np.ndarray:
    matrices = np.zeros((*positions.shape[:-1], 4, 4))
    matrices[..., :3, :3] = rotations
    matrices[..., :3, 3] = positions
    matrices[..., 3, 3] = 1.0
    return matrices


def stored_overrides(armature: Object) -> Mapping[str, str]:
    """The user's bone mapping kept on an armature: custom properties ``chona_bone:<model bone>``."""
    prefix = "chona_bone:"
    keys = list(armature.keys())  # bpy's structs cannot be iterated directly
    return {key[len(prefix) :]: str(armature[key]) for key in keys if key.startswith(prefix)}

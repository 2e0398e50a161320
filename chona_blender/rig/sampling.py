"""Poses and cameras, over a frame range or as they are now.

A range is read from the evaluated depsgraph of a temporary scene. Only rig, objects and cameras are linked to it (what
they depend on is evaluated with them), so a heavy scene costs nothing, constraints, IK and drivers count, and the
user's frame, selection and un-keyed edits stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import Depsgraph, Object, Scene, ViewLayer

from ..camera import CameraSample, ImageFormat, sample_camera, scene_camera
from ..errors import ChonaError

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
    rows: list[tuple[CameraSample, ...]] = []
    subject = _subject(armature, bones, objects)
    posed = np.empty((len(numbers), len(bones), 4, 4))
    placed = np.empty((len(numbers), len(objects), 4, 4))
    with evaluation_scene(scene, linked) as temporary:
        for index, number in enumerate(numbers):
            temporary.frame_set(int(number))
            depsgraph = temporary.view_layers[0].depsgraph
            posed[index], placed[index] = subject.read(depsgraph)
            rows.append(tuple(sample_camera(each, depsgraph, image) for each in chosen[index]) if image else ())
            if progress is not None:
                progress(index + 1, len(numbers), f"sampled frame {number}")
    return Samples(numbers, posed, placed, tuple(rows))


def sample_now(
    scene: Scene,
    depsgraph: Depsgraph,
    armature: Object | None,
    bones: Sequence[str],
    objects: Sequence[Object],
    image: ImageFormat,
) -> Samples:
    """One frame as the scene shows it: edits without a key count, and nothing is evaluated or changed.

    Args:
        depsgraph: evaluated, of a view layer of ``scene``.
        armature, bones, objects, image: see ``sample``; the camera is the scene's.

    Raises:
        ChonaError: see ``sample``; also what the view layer does not evaluate, because it is hidden or excluded.
    """
    if armature is not None or bones:
        armature = check_armature(armature)
    if scene.camera is None:
        raise ChonaError(f"Scene '{scene.name}' has no camera. Add one and make it the scene's active camera")
    for each in (*objects, *([armature] if armature else [])):
        if not _is_evaluated(each, depsgraph.view_layer):
            raise ChonaError(
                f"'{each.name}' is disabled in viewports, or not in the view layer, and does not move. Enable it there "
                "(the eye may be shut)"
            )
    posed, placed = _subject(armature, bones, objects).read(depsgraph)
    number = np.array([scene.frame_current], dtype=np.int64)
    return Samples(number, posed[None], placed[None], ((sample_camera(scene.camera, depsgraph, image),),))


def _is_evaluated(each: Object, view_layer: ViewLayer) -> bool:
    """Whether a view layer keeps an object up to date; one that is hidden by its eye it does."""
    return each.visible_get(view_layer=view_layer) or (each.hide_get(view_layer=view_layer) and not each.hide_viewport)


@dataclass(frozen=True)
class _Subject:
    """What is read in each frame; ``bone_from_rest`` [B, 4, 4] undoes the rest matrices of ``bones``."""

    armature: Object | None
    bones: Sequence[str]
    bone_from_rest: np.ndarray
    objects: Sequence[Object]

    def read(self, depsgraph: Depsgraph) -> tuple[np.ndarray, np.ndarray]:
        """``world_from_armature`` [B, 4, 4] and ``world_from_object`` [N, 4, 4], copied out of Blender."""
        posed = np.empty((0, 4, 4))
        if self.armature is not None:
            evaluated = self.armature.evaluated_get(depsgraph)
            pose = evaluated.pose.bones
            world = np.array(evaluated.matrix_world, dtype=np.float64)
            local = np.array([pose[name].matrix for name in self.bones], dtype=np.float64).reshape(-1, 4, 4)
            posed = world @ local @ self.bone_from_rest
        placed = [np.array(each.evaluated_get(depsgraph).matrix_world, dtype=np.float64) for each in self.objects]
        return posed, np.array(placed).reshape(-1, 4, 4)


def _subject(armature: Object | None, bones: Sequence[str], objects: Sequence[Object]) -> _Subject:
    rest = np.array([armature.data.bones[name].matrix_local for name in bones], dtype=np.float64) if armature else None
    bone_from_rest = np.linalg.inv(rest) if rest is not None and len(rest) else np.empty((0, 4, 4))
    return _Subject(armature, bones, bone_from_rest, objects)


def stored_overrides(armature: Object) -> Mapping[str, str]:
    """The user's bone mapping kept on an armature: custom properties ``chona_bone:<model bone>``."""
    prefix = "chona_bone:"
    keys = list(armature.keys())  # bpy's structs cannot be iterated directly
    return {key[len(prefix) :]: str(armature[key]) for key in keys if key.startswith(prefix)}

"""Poses and cameras, over a frame range or as they are now.

A range is read from the evaluated depsgraph of a temporary scene. Only rig, objects and cameras are linked to it (what
they depend on is evaluated with them), so a heavy scene costs nothing, constraints, IK and drivers count, and the
user's frame, selection and un-keyed edits stay as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import Depsgraph, Object, Scene, ViewLayer

from ..camera import CameraSample, ImageFormat, sample_camera, scene_camera
from ..errors import ChonaError
from .simulation import played, simulated

Progress = Callable[[int, int, str], None]
"""Called with frames done, frames in all, and what is being done; may raise to stop."""


@dataclass(frozen=True)
class Samples:
    """Blender's own matrices, as they are: they may scale and shear.

    Attributes:
        frames: [F] int64; repeated where a frame was sampled at several moments.
        world_from_armature: [F, B, 4, 4] where each bone takes the armature's rest space in the world.
        world_from_object: [F, N, 4, 4] evaluated object matrices.
        cameras: F tuples of C cameras.
        world_from_rig: [F, 4, 4] the armature object itself; identities without one.
    """

    frames: np.ndarray
    world_from_armature: np.ndarray
    world_from_object: np.ndarray
    cameras: tuple[tuple[CameraSample, ...], ...]
    world_from_rig: np.ndarray


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


@dataclass(frozen=True)
class Subject:
    """What one actor is sampled from.

    Attributes:
        armature: None for objects alone; ``bones`` is empty then.
        bones: B bone names of the armature.
        objects: N objects of any kind; their transforms count.
    """

    armature: Object | None
    bones: Sequence[str]
    objects: Sequence[Object]

    def check(self) -> None:
        """Raises ChonaError where the armature cannot be sampled."""
        if self.armature is not None or self.bones:
            check_armature(self.armature)

    @property
    def items(self) -> list[Object]:
        """Everything that moves."""
        return [*self.objects, *([self.armature] if self.armature is not None else [])]


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
    """Samples one actor; see ``sample_all``."""
    subject = Subject(armature, bones, objects)
    return sample_all(scene, [subject], frames=frames, image=image, cameras=cameras, progress=progress)[0]


def sample_all(
    scene: Scene,
    subjects: Sequence[Subject],
    *,
    frames: Iterable[int],
    image: ImageFormat | None = None,
    cameras: Sequence[Object] | None = None,
    moments: Sequence[float] = (0.0,),
    progress: Progress | None = None,
) -> list[Samples]:
    """Samples actors and cameras in one pass over the frames.  Not to be called while drawing.

    Where something hangs on a rigid body simulation, the scene is played from the simulation's start.

    Args:
        scene: whose timing (and, with ``cameras`` None, whose camera and markers) count.
        image: the pixels cameras are sampled for; None samples no camera.
        cameras: C cameras; None takes the one the scene renders each frame with.
        moments: M times at which every frame is sampled, frames from its own.

    Returns:
        as many as subjects, with all moments of a frame one after the other; cameras are the same in all.

    Raises:
        ChonaError: no frames, an armature that cannot be sampled, a camera that cannot be rendered.
    """
    numbers = frame_list(frames)
    for subject in subjects:
        subject.check()
    chosen: list[tuple[Object, ...]] = [()] * len(numbers)
    if image is not None:
        chosen = [tuple(cameras) if cameras is not None else (scene_camera(scene, int(n)),) for n in numbers]
    linked = [*(item for subject in subjects for item in subject.items), *(each for row in chosen for each in row)]
    rows: list[tuple[CameraSample, ...]] = []
    readers = [_Reader.of(subject) for subject in subjects]
    with _frames(scene, linked) as advance:
        for index, number in enumerate(numbers):
            for moment in moments:
                depsgraph = advance(float(number + moment))
                for reader in readers:
                    reader.read(depsgraph)
                rows.append(tuple(sample_camera(each, depsgraph, image) for each in chosen[index]) if image else ())
            if progress is not None:
                progress(index + 1, len(numbers), f"sampled frame {number}")
    return [reader.samples(np.repeat(numbers, len(moments)), tuple(rows)) for reader in readers]


@contextmanager
def _frames(scene: Scene, linked: Sequence[Object]) -> Iterator[Callable[[float], Depsgraph]]:
    """A function from a time in frames to a depsgraph in which ``linked`` stands as it does then."""
    if simulated(scene, linked) is not None:
        layer = bpy.context.view_layer if scene == bpy.context.scene else scene.view_layers[0]
        for each in linked:
            _check_evaluated(each, layer)
        with played(scene, linked) as advance:
            yield advance
        return
    with evaluation_scene(scene, linked) as temporary:

        def advance(time: float) -> Depsgraph:
            whole = math.floor(time)
            temporary.frame_set(whole, subframe=time - whole)
            return temporary.view_layers[0].depsgraph

        yield advance


def sample_now(scene: Scene, depsgraph: Depsgraph, subjects: Sequence[Subject], image: ImageFormat) -> list[Samples]:
    """One frame as the scene shows it: edits without a key count, and nothing is evaluated or changed.

    Args:
        depsgraph: evaluated, of a view layer of ``scene``.
        subjects, image: see ``sample_all``; the camera is the scene's.

    Raises:
        ChonaError: see ``sample_all``; also what the view layer does not evaluate, because it is hidden or excluded.
    """
    for subject in subjects:
        subject.check()
    if scene.camera is None:
        raise ChonaError(f"Scene '{scene.name}' has no camera. Add one and make it the scene's active camera")
    for each in (item for subject in subjects for item in subject.items):
        _check_evaluated(each, depsgraph.view_layer)
    readers = [_Reader.of(subject) for subject in subjects]
    for reader in readers:
        reader.read(depsgraph)
    cameras = ((sample_camera(scene.camera, depsgraph, image),),)
    return [reader.samples(np.array([scene.frame_current], dtype=np.int64), cameras) for reader in readers]


def _check_evaluated(each: Object, view_layer: ViewLayer) -> None:
    if not _is_evaluated(each, view_layer):
        raise ChonaError(
            f"'{each.name}' is disabled in viewports, or not in the view layer, and does not move. Enable it there "
            "(the eye may be shut)"
        )


def _is_evaluated(each: Object, view_layer: ViewLayer) -> bool:
    """Whether a view layer keeps an object up to date; one that is hidden by its eye it does."""
    return each.visible_get(view_layer=view_layer) or (each.hide_get(view_layer=view_layer) and not each.hide_viewport)


@dataclass(frozen=True)
class _Reader:
    """Reads a subject frame by frame; ``bone_from_rest`` [B, 4, 4] undoes the rest matrices of its bones."""

    subject: Subject
    bone_from_rest: np.ndarray
    posed: list[np.ndarray]
    placed: list[np.ndarray]
    rigs: list[np.ndarray]

    @staticmethod
    def of(subject: Subject) -> _Reader:
        rest = np.empty((0, 4, 4))
        if subject.armature is not None and len(subject.bones):
            rest = np.array(
                [subject.armature.data.bones[name].matrix_local for name in subject.bones], dtype=np.float64
            )
        return _Reader(subject, np.linalg.inv(rest), [], [], [])

    def read(self, depsgraph: Depsgraph) -> None:
        """Copies matrices out of Blender."""
        posed, world = np.empty((0, 4, 4)), np.eye(4)
        if self.subject.armature is not None:
            evaluated = self.subject.armature.evaluated_get(depsgraph)
            pose = evaluated.pose.bones
            world = np.array(evaluated.matrix_world, dtype=np.float64)
            local = np.array([pose[name].matrix for name in self.subject.bones], dtype=np.float64).reshape(-1, 4, 4)
            posed = world @ local @ self.bone_from_rest
        self.posed.append(posed)
        self.rigs.append(world)
        objects = [np.array(o.evaluated_get(depsgraph).matrix_world, dtype=np.float64) for o in self.subject.objects]
        self.placed.append(np.array(objects).reshape(-1, 4, 4))

    def samples(self, frames: np.ndarray, cameras: tuple[tuple[CameraSample, ...], ...]) -> Samples:
        """All that was read."""
        return Samples(frames, np.array(self.posed), np.array(self.placed), cameras, np.array(self.rigs))


def stored_overrides(armature: Object) -> Mapping[str, str]:
    """The user's bone mapping kept on an armature: custom properties ``chona_bone:<model bone>``."""
    prefix = "chona_bone:"
    keys = list(armature.keys())  # bpy's structs cannot be iterated directly
    return {key[len(prefix) :]: str(armature[key]) for key in keys if key.startswith(prefix)}

"""Captures a rigged character and an object of a scene as training data (docs/file-formats.md).

Every sequence is a folder of finished frames; ``finish_capture`` writes ``capture.json`` last.  Interrupted captures go
on where they stopped: a frame's folder gets its name when all its images are there.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bpy.types import Object, Scene

from .camera import ImageFormat
from .capture_files import frame_folder, resume
from .capture_person import object_extent, skeleton_of, write_person
from .capture_render import (
    colour_scene,
    mask_scene,
    no_depth_of_field,
    read_png,
    render_still,
    write_grey_png,
)
from .capture_ring import Space, check_ring, cut_off, ring_cameras, ring_poses
from .capture_settings import CaptureResult, CaptureSettings, camera_names, check_request
from .errors import ChonaError
from .rig.mapping import bone_mapping
from .rig.rest_pose import RestPose, captured_rest_pose
from .rig.rigid import RigidPose, rigid_pose
from .rig.sampling import Progress, Samples, check_armature, sample

SIZE_TOLERANCE = 0.01
"""Largest relative change of an object's size over the frames."""


@dataclass(frozen=True)
class Cast:
    """Who and what is captured: the armature, the meshes it moves, and the object with its frame (or neither)."""

    armature: Object
    character: Sequence[Object]
    things: Sequence[Object]
    frame: Object | None


@dataclass(frozen=True)
class Performance:
    """A sequence before it is rendered.

    Attributes:
        cast: who is captured; rest: the person's rest pose; frames: [F] scene frames.
        cameras: objects; description: of ``sequence.json``; arrays: of ``poses.npz``.
        dropped, warnings: see ``CaptureResult``.
    """

    cast: Cast
    rest: RestPose
    frames: np.ndarray
    cameras: Sequence[Object]
    description: dict[str, Any]
    arrays: dict[str, np.ndarray]
    dropped: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Stage:
    """Two temporary scenes that render a performance: with the scene's light, and the masks."""

    colour: Scene
    masks: Scene

    def set_frame(self, frame: int) -> None:
        """Go to a frame."""
        self.colour.frame_set(frame)
        self.masks.frame_set(frame)

    def render(self, camera: Object, stem: Path) -> None:
        """Write ``STEM.color.png``, ``STEM.person_mask.png`` and ``STEM.object_mask.png``."""
        render_still(self.colour, camera, stem.with_name(f"{stem.name}.color.png"))
        both = stem.with_name(f"{stem.name}.masks.png")
        render_still(self.masks, camera, both)
        pixels = read_png(both)
        write_grey_png(stem.with_name(f"{stem.name}.person_mask.png"), pixels[..., 0])
        write_grey_png(stem.with_name(f"{stem.name}.object_mask.png"), pixels[..., 1])
        both.unlink()


def capture_sequence(
    scene: Scene,
    armature: Object,
    character_meshes: Sequence[Object],
    object_meshes: Sequence[Object],
    object_frame: Object | None,
    settings: CaptureSettings,
    *,
    progress: Progress | None = None,
) -> CaptureResult:
    """Renders a sequence; frames that are finished and have not changed are skipped.

    Nothing in the user's scene is left changed, also when this raises.

    Args:
        armature: moves the character.
        object_meshes, object_frame: the object and what its frame is (an empty or one of its meshes).
        progress: called with images done, images in all, and a message; may raise to stop after the current image.

    Raises:
        ChonaError: what is missing, cannot be sampled or contradicts what the folder already holds.
    """
    cast = Cast(armature, character_meshes, object_meshes, object_frame)
    folder = Path(settings.folder) / "sequences" / settings.sequence_name
    with performance(scene, cast, settings) as shown:
        finished = resume(folder, shown.description, shown.arrays)
        write_surface(scene, shown, Path(settings.folder) / "persons" / f"{settings.person}.npz")
        missing = [int(frame) for frame in shown.frames if int(frame) not in finished]
        count = len(shown.cameras)
        done, total = (len(shown.frames) - len(missing)) * count, len(shown.frames) * count
        if missing:
            with stage(scene, shown, settings) as stands:
                for frame in missing:
                    partial = folder / f".{frame_folder(frame)}.partial"
                    shutil.rmtree(partial, ignore_errors=True)
                    partial.mkdir(parents=True)
                    try:
                        stands.set_frame(frame)
                        for camera, name in zip(shown.cameras, shown.description["cameras"], strict=True):
                            stands.render(camera, partial / name)
                            done += 1
                            if progress is not None:
                                progress(done, total, f"{settings.sequence_name}, frame {frame}, {name}")
                        partial.replace(folder / frame_folder(frame))
                    finally:
                        shutil.rmtree(partial, ignore_errors=True)
    return CaptureResult(
        folder, len(missing), len(shown.frames) - len(missing), tuple(shown.description["cameras"]), shown.dropped,
        shown.warnings,
    )  # fmt: skip


@contextmanager
def performance(scene: Scene, cast: Cast, settings: CaptureSettings) -> Iterator[Performance]:
    """Samples everything that moves, and has the cameras ready while the block runs.

    Raises:
        ChonaError: see ``capture_sequence``.
    """
    check_request(cast.armature, cast.character, cast.things, cast.frame, settings)
    rig = check_armature(cast.armature)
    names, parents = (settings.names, settings.parents) if settings.names else skeleton_of(rig)
    bones = list(bone_mapping(rig, names, settings.overrides).values())
    samples = sample(scene, rig, bones, [cast.frame] if cast.frame is not None else [], frames=settings.frames)
    rest, pose = _rigid(rig, samples, names, settings)
    objects = {}
    if cast.frame is not None:
        _check_constant_size(samples, settings)
        lower, upper = object_extent(scene, cast.things, pose.world_from_object[0, 0], int(samples.frames[0]))
        objects[settings.object_name] = {"lower": lower.tolist(), "upper": upper.tolist()}
    with ExitStack() as stack:
        cameras, warnings = list(settings.cameras), []
        if not cameras:
            points = np.concatenate([pose.world_from_bone, pose.world_from_object], axis=1)[..., :3, 3]
            space, size = Space.around(points), (settings.width, settings.height)
            check_ring(settings.ring, space, points, samples.frames)
            short = int(cut_off(ring_poses(settings.ring, space, *size), points, settings.ring.lens, *size).sum())
            if short:
                warnings.append(
                    f"{short} of {settings.ring.cameras} cameras do not see all of the character in every frame; set a "
                    "larger radius (0 fits it), or a shorter lens"
                )
            cameras = stack.enter_context(ring_cameras(settings.ring, space, *size))
        description = {
            "name": settings.sequence_name,
            "person": settings.person,
            "objects": list(objects),
            "cameras": camera_names(cameras),
            "width": settings.width,
            "height": settings.height,
            "skeleton": {"names": list(names), "parents": list(parents or ())},
            "rest_joints": rest.canonical_joints.tolist(),
            "extents": objects,
        }
        yield Performance(
            cast, rest, samples.frames, cameras, description, _poses(scene, cameras, pose, samples, settings),
            tuple(str(each) for each in pose.dropped if each.name in names), tuple(warnings),
        )  # fmt: skip


@contextmanager
def stage(scene: Scene, shown: Performance, settings: CaptureSettings) -> Iterator[Stage]:
    """The scenes that render a performance; removed afterwards."""
    cast = shown.cast
    only = [*cast.character, *cast.things] if settings.hide_scenery else None
    size = {"width": settings.width, "height": settings.height, "device": settings.device, "only": only}
    with ExitStack() as stack:
        stack.enter_context(no_depth_of_field(shown.cameras))
        colour = stack.enter_context(colour_scene(scene, samples=settings.samples, denoise=settings.denoise, **size))
        masks = stack.enter_context(
            mask_scene(scene, cast.character, cast.things, samples=settings.mask_samples, **size)
        )
        yield Stage(colour, masks)


def write_surface(scene: Scene, shown: Performance, path: Path) -> None:
    """Writes the person's surface."""
    cast = shown.cast
    write_person(path, scene, cast.armature, cast.character, rest=shown.rest, frame=int(shown.frames[0]))


def _rigid(
    armature: Object, samples: Samples, names: Sequence[str], settings: CaptureSettings
) -> tuple[RestPose, RigidPose]:
    """Rest pose in metres of the world, and rigid frames at scale 1."""
    objects = [settings.object_name] * samples.world_from_object.shape[1]
    bones = bone_mapping(armature, names, settings.overrides).values()
    metres = 1.0
    for _ in range(2):  # the second round knows the figure's scale
        rest = captured_rest_pose(armature, list(bones), metres, settings.axes)
        pose = rigid_pose(samples, rest, names, objects, object_limit=None)
        if pose.scale == 1.0:
            break
        metres *= pose.scale
    return rest, pose


def _check_constant_size(samples: Samples, settings: CaptureSettings) -> None:
    stretch = np.linalg.svd(samples.world_from_object[:, 0, :3, :3], compute_uv=False)
    change = np.abs(stretch / stretch[0] - 1.0).max(axis=1)
    if change.max() > SIZE_TOLERANCE:
        raise ChonaError(
            f"Object '{settings.object_name}' changes its size by {100 * change.max():.0f} % up to frame "
            f"{samples.frames[change.argmax()]}; captured objects are rigid. Remove the keys on its scale"
        )


def _poses(
    scene: Scene, cameras: Sequence[Object], pose: RigidPose, samples: Samples, settings: CaptureSettings
) -> dict[str, np.ndarray]:
    """The arrays of ``poses.npz``."""
    image = ImageFormat.plain(settings.width, settings.height)
    seen = sample(scene, None, [], [], frames=samples.frames, image=image, cameras=cameras).cameras
    return {
        "frames": samples.frames,
        "world_from_bone": pose.world_from_bone,
        "world_from_object": pose.world_from_object,
        "intrinsics": np.array([[each.intrinsics for each in row] for row in seen]).swapaxes(0, 1),
        "world_from_camera": np.array([[each.world_from_camera for each in row] for row in seen]).swapaxes(0, 1),
    }

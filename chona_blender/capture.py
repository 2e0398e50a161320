"""Captures a rigged character and an object of a scene as training data (docs/file-formats.md).

Every sequence is a folder of finished frames; ``finish_capture`` writes ``capture.json`` last.  Interrupted captures go
on where they stopped: a frame's folder gets its name when all its images are there.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bpy.types import Object, Scene

from .camera import ImageFormat, camera_kind
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
from .capture_ring import ring_cameras
from .errors import ChonaError
from .rig.mapping import bone_mapping
from .rig.rest_pose import RestPose, captured_rest_pose
from .rig.rigid import RigidPose, rigid_pose
from .rig.sampling import Progress, Samples, check_armature, sample

SIZE_TOLERANCE = 0.01
"""Largest relative change of an object's size over the frames."""


@dataclass(frozen=True)
class CaptureSettings:
    """What is captured, and how well.

    Attributes:
        folder: of the capture; several sequences may go into one.
        person, object_name: identities; ``object_name`` None captures a person alone.
        frames: scene frames.
        sequence: name of the sequence, default ``<person>_<object>``.
        cameras: camera objects of the scene; empty takes a ring of ``ring`` temporary ones.
        ring: number of temporary cameras.
        width, height: pixels.
        samples, mask_samples: Cycles samples a pixel of colour and masks.
        denoise: colour images.
        device: ``CPU`` or ``GPU`` (as set up in Blender's preferences).
        hide_scenery: renders only character, object and lights.
        names, parents: skeleton to capture with; None takes the armature's deforming bones.
        overrides: bone mapping, skeleton bone → armature bone.
        axes: of the armature, see ``captured_rest_pose``.
    """

    folder: Path
    person: str
    object_name: str | None
    frames: Sequence[int]
    sequence: str | None = None
    cameras: Sequence[Object] = ()
    ring: int = 8
    width: int = 384
    height: int = 288
    samples: int = 32
    mask_samples: int = 16
    denoise: bool = True
    device: str = "CPU"
    hide_scenery: bool = False
    names: tuple[str, ...] | None = None
    parents: tuple[int, ...] | None = None
    overrides: dict[str, str] | None = None
    axes: str = "AUTO"

    @property
    def sequence_name(self) -> str:
        """The sequence's folder name."""
        return self.sequence or "_".join([self.person, *([self.object_name] if self.object_name else [])])


@dataclass(frozen=True)
class CaptureResult:
    """What ``capture_sequence`` did.

    Attributes:
        folder: of the sequence.
        rendered, skipped: numbers of frames.
        cameras: names, as in the file names.
        dropped: scale and shear that was dropped of the bones, as text, the worst first.
    """

    folder: Path
    rendered: int
    skipped: int
    cameras: tuple[str, ...]
    dropped: tuple[str, ...]


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
    _check_request(character_meshes, object_meshes, object_frame, settings)
    names, parents = (settings.names, settings.parents) if settings.names else skeleton_of(check_armature(armature))
    bones = list(bone_mapping(check_armature(armature), names, settings.overrides).values())
    frames = [object_frame] if object_frame is not None else []
    samples = sample(scene, armature, bones, frames, frames=settings.frames)
    rest, pose = _rigid(armature, samples, names, settings)
    objects = {}
    if object_frame is not None:
        _check_constant_size(samples, settings)
        lower, upper = object_extent(scene, object_meshes, pose.world_from_object[0, 0], int(samples.frames[0]))
        objects[settings.object_name] = {"lower": lower.tolist(), "upper": upper.tolist()}
    folder = Path(settings.folder) / "sequences" / settings.sequence_name
    with ExitStack() as stack:
        cameras = list(settings.cameras)
        if not cameras:
            points = np.concatenate([pose.world_from_bone, pose.world_from_object], axis=1)[..., :3, 3].reshape(-1, 3)
            cameras = stack.enter_context(ring_cameras(settings.ring, points, settings.width, settings.height))
        arrays = _poses(scene, cameras, pose, samples, settings)
        description = {
            "name": settings.sequence_name,
            "person": settings.person,
            "objects": list(objects),
            "cameras": _camera_names(cameras),
            "width": settings.width,
            "height": settings.height,
            "skeleton": {"names": list(names), "parents": list(parents or ())},
            "rest_joints": rest.canonical_joints.tolist(),
            "extents": objects,
        }
        finished = resume(folder, description, arrays)
        write_person(
            Path(settings.folder) / "persons" / f"{settings.person}.npz",
            scene, armature, character_meshes, rest=rest, frame=int(samples.frames[0]),
        )  # fmt: skip
        only = [*character_meshes, *object_meshes] if settings.hide_scenery else None
        missing = [int(frame) for frame in samples.frames if int(frame) not in finished]
        done, total = (len(samples.frames) - len(missing)) * len(cameras), len(samples.frames) * len(cameras)
        size = {"width": settings.width, "height": settings.height, "device": settings.device, "only": only}
        if missing:
            stack.enter_context(no_depth_of_field(cameras))
            colour = stack.enter_context(
                colour_scene(scene, samples=settings.samples, denoise=settings.denoise, **size)
            )
            masks = stack.enter_context(
                mask_scene(scene, character_meshes, object_meshes, samples=settings.mask_samples, **size)
            )
        for frame in missing:
            partial = folder / f".{frame_folder(frame)}.partial"
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir(parents=True)
            try:
                colour.frame_set(frame)
                masks.frame_set(frame)
                for camera, name in zip(cameras, description["cameras"], strict=True):
                    _render_images(colour, masks, camera, partial / name)
                    done += 1
                    if progress is not None:
                        progress(done, total, f"{settings.sequence_name}, frame {frame}, {name}")
                partial.replace(folder / frame_folder(frame))
            finally:
                shutil.rmtree(partial, ignore_errors=True)
    return CaptureResult(
        folder,
        len(missing),
        len(samples.frames) - len(missing),
        tuple(description["cameras"]),
        tuple(str(each) for each in pose.dropped if each.name in names),
    )


def _render_images(colour: Scene, masks: Scene, camera: Object, stem: Path) -> None:
    render_still(colour, camera, stem.with_name(f"{stem.name}.color.png"))
    both = stem.with_name(f"{stem.name}.masks.png")
    render_still(masks, camera, both)
    pixels = read_png(both)
    write_grey_png(stem.with_name(f"{stem.name}.person_mask.png"), pixels[..., 0])
    write_grey_png(stem.with_name(f"{stem.name}.object_mask.png"), pixels[..., 1])
    both.unlink()


def _check_request(
    character: Sequence[Object], things: Sequence[Object], frame: Object | None, settings: CaptureSettings
) -> None:
    if not character:
        raise ChonaError("No mesh of the character was given. Choose the meshes that the armature deforms")
    if (settings.object_name is None) != (frame is None) or (frame is None) != (not things):
        raise ChonaError(
            "An object needs a name, meshes and a frame (an empty or a mesh); give all three, or none to capture the "
            "person alone"
        )
    both = [each.name for each in things if each in list(character)]
    if both:
        raise ChonaError(f"Mesh '{both[0]}' is given as character and as object. Leave it out of one of them")
    if not settings.cameras and settings.ring < 1:
        raise ChonaError(f"A capture needs cameras, got none and a ring of {settings.ring}. Choose cameras or a ring")
    for each in settings.cameras:
        if camera_kind(each) != "PERSP":
            raise ChonaError(
                f"Camera '{each.name}' is orthographic; captures need perspective cameras. Change its type"
            )
    if min(settings.width, settings.height) < 1 or min(settings.samples, settings.mask_samples) < 1:
        raise ChonaError("Image size and samples must be at least 1. Enter larger numbers")
    for name in (settings.person, settings.object_name, settings.sequence_name):
        if name is not None and name != _safe(name):
            raise ChonaError(f"'{name}' cannot be a file name. Use letters, digits, '-', '_' and '.'")
    if (settings.names is None) != (settings.parents is None):
        raise ChonaError("A skeleton is given by names and parents together. Give both, or neither")


def _safe(name: str) -> str:
    return re.sub(r"[^\w.\-]", "_", name).lstrip(".") or "_"


def _camera_names(cameras: Sequence[Object]) -> list[str]:
    names = [_safe(each.name) for each in cameras]
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise ChonaError(f"Two cameras would be called '{doubled[0]}' on disk. Rename one of them")
    return names


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

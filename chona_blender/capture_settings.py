"""What is captured and how, what comes of it, and what is refused before anything is rendered."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bpy.types import Object

from .camera import camera_kind
from .capture_ring import Ring
from .errors import ChonaError


@dataclass(frozen=True)
class CaptureSettings:
    """What is captured, and how well.

    Attributes:
        folder: of the capture; several sequences may go into one.
        person, object_name: identities; ``object_name`` None captures a person alone.
        frames: scene frames.
        sequence: name of the sequence, default ``<person>_<object>``.
        cameras: camera objects of the scene; empty takes a ``ring`` of temporary ones.
        ring: how the temporary cameras stand.
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
    ring: Ring = field(default_factory=Ring)
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
        warnings: what is as asked for, but hardly as meant.
    """

    folder: Path
    rendered: int
    skipped: int
    cameras: tuple[str, ...]
    dropped: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def check_request(
    armature: Object, character: Sequence[Object], things: Sequence[Object], frame: Object | None,
    settings: CaptureSettings,
) -> None:  # fmt: skip
    """Raises ChonaError for what cannot be captured."""
    if not character:
        raise ChonaError(
            f"No mesh follows the armature '{armature.name}': none has it in an Armature modifier, and none is its "
            "child. Choose the armature that moves the visible character (of Rigify the generated rig, not the "
            "metarig), or parent the mesh to it with Armature Deform"
        )
    if (settings.object_name is None) != (frame is None) or (frame is None) != (not things):
        raise ChonaError(
            "An object needs a name, meshes and a frame (an empty or a mesh); give all three, or none to capture the "
            "person alone"
        )
    both = [each.name for each in things if each in list(character)]
    if both:
        raise ChonaError(f"Mesh '{both[0]}' is given as character and as object. Leave it out of one of them")
    if not settings.cameras and settings.ring.cameras < 1:
        raise ChonaError(
            f"A capture needs cameras, got none and {settings.ring.rings} rings of {settings.ring.count}. Choose "
            "cameras or a ring"
        )
    for each in settings.cameras:
        if camera_kind(each) != "PERSP":
            raise ChonaError(
                f"Camera '{each.name}' is orthographic; captures need perspective cameras. Change its type"
            )
    if min(settings.width, settings.height) < 1 or min(settings.samples, settings.mask_samples) < 1:
        raise ChonaError("Image size and samples must be at least 1. Enter larger numbers")
    for name in (settings.person, settings.object_name, settings.sequence_name):
        if name is not None and name != safe_name(name):
            raise ChonaError(f"'{name}' cannot be a file name. Use letters, digits, '-', '_' and '.'")
    if (settings.names is None) != (settings.parents is None):
        raise ChonaError("A skeleton is given by names and parents together. Give both, or neither")


def safe_name(name: str) -> str:
    """A name that can be a file's."""
    return re.sub(r"[^\w.\-]", "_", name).lstrip(".") or "_"


def camera_names(cameras: Sequence[Object]) -> list[str]:
    """Names of cameras on the disk.

    Raises:
        ChonaError: two would be the same.
    """
    names = [safe_name(each.name) for each in cameras]
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise ChonaError(f"Two cameras would be called '{doubled[0]}' on disk. Rename one of them")
    return names

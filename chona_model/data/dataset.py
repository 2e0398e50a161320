"""What every reader returns: views with cameras, masks and poses, in this package's conventions.

Readers convert once (axes, pixel centres, units); nothing after them knows which dataset a view came from.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from chona_model.camera import Camera
from chona_model.data.lens import Lens
from chona_model.skeleton import Skeleton


class DatasetError(ValueError):
    """A capture that cannot be used: the message says what was found, what was expected and what to do."""


@dataclass(frozen=True)
class SkinnedSurface:
    """A body model's surface in canonical space, from which skinning weights can be started.

    Attributes:
        vertices: [V, 3] metres.
        weights: [V, B] rows sum to one.
        faces: [F, 3] vertex indices.
    """

    vertices: np.ndarray
    weights: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class Person:
    """One human identity.

    Attributes:
        name: as the user chooses it in Blender.
        rest_joints: [B, 3] canonical joints, metres.
        surface: the body model in canonical space, where the dataset has one.
    """

    name: str
    rest_joints: np.ndarray
    surface: SkinnedSurface | None = None


@dataclass(frozen=True)
class ObjectShape:
    """One object identity: an extent around its rigid frame.

    Attributes:
        name: as the user chooses it in Blender.
        lower, upper: [3] corners of a box in the object's own frame, metres.
    """

    name: str
    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True)
class Pose:
    """A person and its objects at one moment, float64, metres.

    Attributes:
        person: name of the person, or None for an object alone.
        objects: names of the N objects.
        world_from_bone: [B, 4, 4] posed bone frames.
        world_from_object: [N, 4, 4] rigid object frames.
    """

    person: str | None
    objects: tuple[str, ...]
    world_from_bone: np.ndarray
    world_from_object: np.ndarray

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of everything that the pose shows, the person first."""
        return self.objects if self.person is None else (self.person, *self.objects)


MASK_THRESHOLD = 127
"""Masks are 8-bit and may be JPEG (BEHAVE): anything above is inside."""


@dataclass(frozen=True)
class MaskRule:
    """How a set's mask files are meant.

    Attributes:
        above: values above it are inside: 127 of 255, or 0 where values are labels.
        alpha: whether the mask is a picture's alpha channel.
    """

    above: int = MASK_THRESHOLD
    alpha: bool = False


@dataclass(frozen=True)
class View:
    """One image of one frame. A missing mask means that part is not in the picture, or that the set lacks it.

    Attributes:
        held_masks: of what counts as the person because nothing else moves it.
        camera: a pinhole; ``lens`` says what the file's pixels have besides.
        ray_share: how many rays a training step draws of this image beside those of a BEHAVE image (paper: 2048 for
            BEHAVE, 1024 for ZJU-MoCap, 512 for CO3D).
    """

    sequence: str
    frame: str
    camera_name: str
    camera: Camera
    pose: Pose
    image: Path
    person_mask: Path | None = None
    object_mask: Path | None = None
    masks: MaskRule = MaskRule()
    lens: Lens | None = None
    ray_share: float = 1.0
    held_masks: tuple[Path, ...] = ()

    @property
    def label(self) -> str:
        """``sequence_frame_camera``, as evaluated images are named."""
        return f"{self.sequence}_{self.frame}_{self.camera_name}"


@dataclass(frozen=True)
class Dataset:
    """A capture, or several joined.

    Attributes:
        skeleton: shared by all persons.
        persons, objects: identities by name.
        views: every usable view.
        gaps: what was missing and skipped, counted by kind ("person mask", "frame", …).
    """

    skeleton: Skeleton
    persons: Mapping[str, Person]
    objects: Mapping[str, ObjectShape]
    views: tuple[View, ...]
    gaps: Counter[str] = field(default_factory=Counter)

"""What is rendered, as one thing: a model that turns a pose, a camera and settings into a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from chona_model.camera import Camera
from chona_model.data.dataset import ObjectShape, Person, Pose
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.settings import RenderSettings
from chona_model.skeleton import Skeleton

EMPTY_DEPTH = 1e10
"""Depth where nothing is, as Blender's Z pass has it."""

CHANNELS = ("rgb", "alpha", "depth", "human", "object", "confidence")
"""What a picture has for every pixel."""

ASKED_FOR = ("normal", "parts")
"""What it has for every pixel where that is asked for."""


@dataclass(frozen=True)
class Picture:
    """One rendered view.

    Attributes:
        rgb: [H, W, 3] float32, sRGB encoded, premultiplied with ``alpha`` as the field integrates it.
        alpha: [H, W]; depth: [H, W] metres along the camera axis, ``EMPTY_DEPTH`` where alpha is 0.
        human, object: [H, W] shares of alpha on the person and on objects.
        confidence: [H, W] share of samples whose inverse skinning converged; 1 where nothing was sampled.
        rays: rays traced; failed_share: share of all samples without a root.
        normal: [H, W, 3] mean of the unit normals of what a pixel shows, in the world and weighted as its colours are:
            no longer than ``alpha``. None where not asked for.
        parts: [H, W, P] shares of alpha on each part of the pose: the person, where there is one, then its objects. Of
            several actors one after the other. None where not asked for.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    human: np.ndarray
    object: np.ndarray
    confidence: np.ndarray
    rays: int
    failed_share: float
    normal: np.ndarray | None = None
    parts: np.ndarray | None = None

    @property
    def channels(self) -> dict[str, np.ndarray]:
        """What the picture has for every pixel, by name."""
        given = {name: getattr(self, name) for name in (*CHANNELS, *ASKED_FOR)}
        return {name: array for name, array in given.items() if array is not None}


def part_count(pose: Pose) -> int:
    """How many parts a pose has: the person, where there is one, and its objects."""
    return (pose.person is not None) + len(pose.objects)


def empty_picture(camera: Camera, passes: Passes = DEFAULT_PASSES, parts: int = 0) -> Picture:
    """A picture of nothing, whose arrays may be written to.

    Args:
        passes: of which normals and Cryptomatte say whether there are normals, and the shares of so many parts.
    """
    size = (camera.height, camera.width)
    return Picture(
        np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.full(size, EMPTY_DEPTH, np.float32),
        np.zeros(size, np.float32), np.zeros(size, np.float32), np.ones(size, np.float32), 0, 0.0,
        np.zeros((*size, 3), np.float32) if passes.normal else None,
        np.zeros((*size, parts), np.float32) if passes.cryptomatte else None,
    )  # fmt: skip


def merge(picture: Picture, traced: Picture, pixels: np.ndarray) -> Picture:
    """``picture`` with the pixels [H, W] bool taken from ``traced``; rays are added, failures averaged over them."""
    rays = picture.rays + traced.rays
    failed = (picture.failed_share * picture.rays + traced.failed_share * traced.rays) / max(rays, 1)
    channels = {
        name: np.where(pixels[..., None] if own.ndim == 3 else pixels, getattr(traced, name), own)
        for name, own in picture.channels.items()
    }
    return replace(picture, **channels, rays=rays, failed_share=failed)


@dataclass(frozen=True)
class Samples:
    """What an actor's rays met: N samples of some pixels' rays.

    Attributes:
        ray: [N] int64 ``(row · width + column) · side² + sub``: rays of a pixel are consecutive.
        depth: [N] metres along the camera axis; alpha: [N] opacity of the sample alone, 0…1; rgb: [N, 3] straight.
        thing: [N] share of the sample that is an object's, 0…1.
        normal: [N, 3] unit, or zero where there is none, in the world; parts: [N, P] shares of the sample on each part
            of the pose, as in ``Picture``. None where not asked for.
    """

    ray: np.ndarray
    depth: np.ndarray
    alpha: np.ndarray
    rgb: np.ndarray
    thing: np.ndarray
    normal: np.ndarray | None = None
    parts: np.ndarray | None = None


class Actor(Protocol):
    """A trained model: ``grid_actor.GridActor`` (preset fast) or ``exact_actor.ExactActor`` (preset paper)."""

    kind: str
    skeleton: Skeleton
    persons: Mapping[str, Person]
    objects: Mapping[str, ObjectShape]
    object_distance: float

    def render(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None = None,
        passes: Passes = DEFAULT_PASSES,
    ) -> Picture:  # fmt: skip
        """Renders a view; ``KeyError`` for identities the model does not know.

        Args:
            pixels: [H, W] bool, those that are traced; the others stay empty. None: all.
            passes: of which normals and Cryptomatte take work of their own.
        """
        ...

    def sample(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray, passes: Passes = DEFAULT_PASSES
    ) -> Samples:
        """What the rays of ``pixels`` [H, W] bool meet, to be integrated with what other actors' rays meet."""
        ...

    def count_rays(self, pose: Pose, camera: Camera, settings: RenderSettings) -> int:
        """How many rays ``render`` would trace, without tracing any; what guided upsampling adds is not in it."""
        ...

    def forget_poses(self) -> None:
        """Makes the next pose ready anew, as a new one would be."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """Everything to save, by name."""
        ...

    def shape(self) -> dict[str, Any]:
        """JSON-able description from which, with the tensors, the actor is rebuilt."""
        ...

"""What is rendered, as one thing: a model that turns a pose, a camera and settings into a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from chona_model.camera import Camera
from chona_model.data.dataset import ObjectShape, Person, Pose
from chona_model.settings import RenderSettings
from chona_model.skeleton import Skeleton

EMPTY_DEPTH = 1e10
"""Depth where nothing is, as Blender's Z pass has it."""

CHANNELS = ("rgb", "alpha", "depth", "human", "object", "confidence")
"""What a picture has for every pixel."""


@dataclass(frozen=True)
class Picture:
    """One rendered view.

    Attributes:
        rgb: [H, W, 3] float32, sRGB encoded, premultiplied with ``alpha`` as the field integrates it.
        alpha: [H, W]; depth: [H, W] metres along the camera axis, ``EMPTY_DEPTH`` where alpha is 0.
        human, object: [H, W] shares of alpha on the person and on objects.
        confidence: [H, W] share of samples whose inverse skinning converged; 1 where nothing was sampled.
        rays: rays traced; failed_share: share of all samples without a root.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    human: np.ndarray
    object: np.ndarray
    confidence: np.ndarray
    rays: int
    failed_share: float


def empty_picture(camera: Camera) -> Picture:
    """A picture of nothing, whose arrays may be written to."""
    size = (camera.height, camera.width)
    return Picture(
        np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.full(size, EMPTY_DEPTH, np.float32),
        np.zeros(size, np.float32), np.zeros(size, np.float32), np.ones(size, np.float32), 0, 0.0,
    )  # fmt: skip


def merge(picture: Picture, traced: Picture, pixels: np.ndarray) -> Picture:
    """``picture`` with the pixels [H, W] bool taken from ``traced``; rays are added, failures averaged over them."""
    rays = picture.rays + traced.rays
    failed = (picture.failed_share * picture.rays + traced.failed_share * traced.rays) / max(rays, 1)
    channels = {
        name: np.where(pixels[..., None] if own.ndim == 3 else pixels, getattr(traced, name), own)
        for name, own in ((name, getattr(picture, name)) for name in CHANNELS)
    }
    return replace(picture, **channels, rays=rays, failed_share=failed)


@dataclass(frozen=True)
class Samples:
    """What an actor's rays met: N samples of some pixels' rays.

    Attributes:
        ray: [N] int64 ``(row · width + column) · side² + sub``: rays of a pixel are consecutive.
        depth: [N] metres along the camera axis; alpha: [N] opacity of the sample alone, 0…1; rgb: [N, 3] straight.
        thing: [N] share of the sample that is an object's, 0…1.
    """

    ray: np.ndarray
    depth: np.ndarray
    alpha: np.ndarray
    rgb: np.ndarray
    thing: np.ndarray


class Actor(Protocol):
    """A trained model: ``grid_actor.GridActor`` (preset fast) or ``exact_actor.ExactActor`` (preset paper)."""

    kind: str
    skeleton: Skeleton
    persons: Mapping[str, Person]
    objects: Mapping[str, ObjectShape]
    object_distance: float

    def render(self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None = None) -> Picture:
        """Renders a view; ``KeyError`` for identities the model does not know.

        Args:
            pixels: [H, W] bool, those that are traced; the others stay empty. None: all.
        """
        ...

    def sample(self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray) -> Samples:
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

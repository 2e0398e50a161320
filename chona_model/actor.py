"""What is rendered, as one thing: a model that turns a pose, a camera and settings into a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from PIL import Image
from torch import Tensor

from chona_model.camera import Camera
from chona_model.data.dataset import ObjectShape, Person, Pose
from chona_model.settings import RenderSettings
from chona_model.skeleton import Skeleton

EMPTY_DEPTH = 1e10
"""Depth where nothing is, as Blender's Z pass has it."""


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


def enlarge(picture: Picture, camera: Camera) -> Picture:
    """A picture rendered at a share of the resolution, interpolated to ``camera``'s; depths of nothing stay so."""

    def resize(channel: np.ndarray, method: Image.Resampling) -> np.ndarray:
        return np.asarray(Image.fromarray(channel).resize((camera.width, camera.height), method))

    linear, nearest = Image.Resampling.BILINEAR, Image.Resampling.NEAREST
    alpha = resize(picture.alpha, linear)
    depth = np.where(alpha > 0, resize(picture.depth, nearest), np.float32(EMPTY_DEPTH))
    return Picture(
        np.stack([resize(np.ascontiguousarray(picture.rgb[..., k]), linear) for k in range(3)], axis=-1), alpha, depth,
        resize(picture.human, linear), resize(picture.object, linear), resize(picture.confidence, linear),
        picture.rays, picture.failed_share,
    )  # fmt: skip


class Actor(Protocol):
    """A trained model: ``grid_actor.GridActor`` (preset fast) or ``exact_actor.ExactActor`` (preset paper)."""

    kind: str
    skeleton: Skeleton
    persons: Mapping[str, Person]
    objects: Mapping[str, ObjectShape]
    object_distance: float

    def render(self, pose: Pose, camera: Camera, settings: RenderSettings) -> Picture:
        """Renders a view; ``ValueError`` for identities the model does not know."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """Everything to save, by name."""
        ...

    def shape(self) -> dict[str, Any]:
        """JSON-able description from which, with the tensors, the actor is rebuilt."""
        ...

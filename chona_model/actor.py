"""What is rendered, as one thing: a model that turns a pose, a camera and settings into a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
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
    """A picture rendered at a share of the resolution, interpolated to ``camera``'s; depths of nothing stay so.

    Only the box that shows anything is interpolated, where the enlargement is by whole numbers.
    """
    height, width = picture.alpha.shape
    source, target = (0, height, 0, width), (0, camera.height, 0, camera.width)
    if camera.height % height == 0 and camera.width % width == 0:
        source = _shown(picture.alpha)
        target = tuple(
            place * (camera.height // height if number < 2 else camera.width // width)
            for number, place in enumerate(source)
        )
    large = empty_picture(camera)
    if source[0] < source[1]:
        _interpolate(picture, large, source, target)
    return replace(large, rays=picture.rays, failed_share=picture.failed_share)


Box = tuple[int, int, int, int]
"""Rows from, to; columns from, to."""

REACH = 2
"""Pixels around what is shown that interpolation touches."""


def _shown(alpha: np.ndarray) -> Box:
    rows, columns = (np.flatnonzero(alpha.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return 0, 0, 0, 0
    height, width = alpha.shape
    return (
        max(int(rows[0]) - REACH, 0), min(int(rows[-1]) + 1 + REACH, height), max(int(columns[0]) - REACH, 0),
        min(int(columns[-1]) + 1 + REACH, width),
    )  # fmt: skip


def _interpolate(small: Picture, large: Picture, source: Box, target: Box) -> None:
    """Writes a box of ``small`` to a box of ``large``."""
    own, size = np.s_[target[0] : target[1], target[2] : target[3]], (target[3] - target[2], target[1] - target[0])
    cut = np.s_[source[0] : source[1], source[2] : source[3]]

    def resize(channel: np.ndarray, method: Image.Resampling = Image.Resampling.BILINEAR) -> np.ndarray:
        return np.asarray(Image.fromarray(np.ascontiguousarray(channel[cut])).resize(size, method))

    for name in ("alpha", "human", "object", "confidence"):
        getattr(large, name)[own] = resize(getattr(small, name))
    for k in range(3):
        large.rgb[..., k][own] = resize(small.rgb[..., k])
    depth = resize(small.depth, Image.Resampling.NEAREST)
    large.depth[own] = np.where(large.alpha[own] > 0, depth, np.float32(EMPTY_DEPTH))


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

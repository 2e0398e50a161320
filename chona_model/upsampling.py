"""Pictures at a share of the resolution: interpolated, and traced again where interpolation would guess."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from PIL import Image
from scipy import ndimage

from chona_model.actor import EMPTY_DEPTH, Picture, empty_picture, merge
from chona_model.camera import Camera
from chona_model.data.dataset import Pose
from chona_model.settings import RenderSettings

Render = Callable[[Pose, Camera, RenderSettings, np.ndarray | None], Picture]
"""Renders at the camera's own size."""

DIFFERS = 0.06
"""Neighbours of the small picture that differ more than this in colour, alpha or mattes are not interpolated."""


def render_scaled(
    render: Render, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None
) -> Picture:
    """Renders at ``settings.resolution`` and upsamples as ``settings.upsampling`` says.

    Args:
        render: of one model; pixels: [H, W] bool at ``camera``'s size, those that are wanted, or None for all. Asking
            for single pixels renders them at full size.
    """
    if settings.resolution >= 1.0 or pixels is not None:
        return render(pose, camera, settings, pixels)
    small = render(pose, camera.scaled(settings.resolution), settings, None)
    large = enlarge(small, camera)
    if settings.upsampling == "bilinear":
        return large
    unsure = uncertain(small, camera)
    return merge(large, render(pose, camera, settings, unsure), unsure)


def uncertain(small: Picture, camera: Camera) -> np.ndarray:
    """[H, W] bool at ``camera``'s size: pixels between small ones that differ by more than ``DIFFERS``."""
    differs = np.zeros(small.alpha.shape, dtype=bool)
    channels: list[np.ndarray] = [*np.moveaxis(small.rgb, -1, 0), small.alpha, small.object]
    for channel in channels:
        low, high = ndimage.minimum_filter(channel, 3), ndimage.maximum_filter(channel, 3)
        differs |= high - low > DIFFERS
    height, width = small.alpha.shape
    rows = np.arange(camera.height) * height // camera.height
    columns = np.arange(camera.width) * width // camera.width
    return differs[np.ix_(rows, columns)]


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
    large = replace(large, normal=_blank(picture.normal, camera), parts=_blank(picture.parts, camera))
    if source[0] < source[1]:
        _interpolate(picture, large, source, target)
    return replace(large, rays=picture.rays, failed_share=picture.failed_share)


def _blank(channel: np.ndarray | None, camera: Camera) -> np.ndarray | None:
    return None if channel is None else np.zeros((camera.height, camera.width, channel.shape[2]), np.float32)


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

    for name, channel in small.channels.items():
        if name != "depth":
            to, given = (np.atleast_3d(array) for array in (getattr(large, name), channel))
            for k in range(given.shape[2]):
                to[..., k][own] = resize(given[..., k])
    depth = resize(small.depth, Image.Resampling.NEAREST)
    large.depth[own] = np.where(large.alpha[own] > 0, depth, np.float32(EMPTY_DEPTH))

"""Pictures in panels: arrays as icons of any size, made outside of drawing.

An icon is drawn into a square, so pictures are made square: what is missing stays as dark as a panel.
"""

from __future__ import annotations

import struct
from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

BACKGROUND = (0.11, 0.11, 0.11)
"""sRGB, as Blender's own plots have it."""
MOST_PIXELS = 1 << 24

_icons: list[bpy.utils.previews.ImagePreviewCollection] = []


def show(name: str, rgb: np.ndarray) -> None:
    """Make or replace the picture ``name``.

    Args:
        rgb: [H, W, 3] in 0…1, sRGB encoded, the top row first.
    """
    if not _icons:
        return
    picture = squared(rgb)
    side = picture.shape[0]
    rgba = np.concatenate([picture[::-1], np.ones((side, side, 1))], axis=-1).astype(np.float32)
    collection = _icons[0]
    icon = collection[name] if name in collection else collection.new(name)
    icon.image_size = (side, side)
    icon.image_pixels_float.foreach_set(rgba.ravel())


def icon(name: str) -> int:
    """The icon of a picture for ``template_icon``; 0 where there is none."""
    return _icons[0][name].icon_id if _icons and name in _icons[0] else 0


def pixels(name: str) -> np.ndarray | None:
    """What ``show`` was given, squared: [S, S, 3] in 0…1; None where there is none."""
    if not _icons or name not in _icons[0]:
        return None
    shown = _icons[0][name]
    flat = np.empty(shown.image_size[0] * shown.image_size[1] * 4, dtype=np.float32)
    shown.image_pixels_float.foreach_get(flat)
    return flat.reshape(shown.image_size[1], shown.image_size[0], 4)[::-1, :, :3]


def forget(name: str) -> None:
    """Take a picture away."""
    if _icons and name in _icons[0]:
        del _icons[0][name]


def squared(rgb: np.ndarray) -> np.ndarray:
    """[S, S, 3] with the picture in the middle."""
    height, width = rgb.shape[:2]
    side = max(height, width)
    picture = np.broadcast_to(np.array(BACKGROUND), (side, side, 3)).copy()
    top, left = (side - height) // 2, (side - width) // 2
    picture[top : top + height, left : left + width] = rgb
    return picture


def shrunk(rgb: np.ndarray, most: int) -> np.ndarray:
    """The picture with sides of at most ``most`` pixels, averaged over whole pixels."""
    step = -(-max(rgb.shape[:2]) // most)
    height, width = (size // step * step for size in rgb.shape[:2])
    return rgb[:height, :width].reshape(height // step, step, width // step, step, 3).mean(axis=(1, 3))


def read(path: Path) -> np.ndarray:
    """[H, W, 3] in 0…1 of an image file, as it is encoded.

    Raises:
        RuntimeError: it is no PNG that Blender can read, or has more than `MOST_PIXELS`.
    """
    _check_size(path)
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        if width * height * image.channels == 0 or image.channels < 3:
            raise RuntimeError(f"{path} is damaged")
        flat = np.empty(width * height * image.channels, dtype=np.float32)
        image.pixels.foreach_get(flat)
        channels = image.channels
    finally:
        bpy.data.images.remove(image)
    return flat.reshape(height, width, channels)[::-1, :, :3].astype(np.float64)


def _check_size(path: Path) -> None:
    """Refuses what would take minutes and gigabytes, by the file's first bytes alone."""
    try:
        with path.open("rb") as file:
            start = file.read(24)
    except OSError as error:
        raise RuntimeError(f"{path} cannot be read: {error.strerror}") from error
    if len(start) < 24 or not start.startswith(b"\x89PNG\r\n\x1a\n") or start[12:16] != b"IHDR":
        raise RuntimeError(f"{path} is no PNG")
    width, height = struct.unpack(">II", start[16:])
    if not 0 < width * height <= MOST_PIXELS:
        raise RuntimeError(f"{path} has {width} x {height} pixels, expected at most {MOST_PIXELS}")


def register() -> None:
    """Be ready to hold pictures."""
    _icons.append(bpy.utils.previews.new())


def unregister() -> None:
    """Let all go."""
    while _icons:
        bpy.utils.previews.remove(_icons.pop())

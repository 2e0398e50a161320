"""Images and masks of captures: opened without trust, and read as pixels without their background."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from chona_model.camera import Camera
from chona_model.data.dataset import DatasetError, View
from chona_model.plain_json import shortened


@dataclass(frozen=True)
class Pixels:
    """A view's pixels with the background removed.

    Attributes:
        rgb: [H, W, 3] float32 in 0…1, sRGB encoded, black outside the masks.
        person, object: [H, W] bool, disjoint.
    """

    rgb: np.ndarray
    person: np.ndarray
    object: np.ndarray

    @property
    def mask(self) -> np.ndarray:
        """[H, W] bool: person or object."""
        return self.person | self.object


WIDE_MODES = ("I", "F")
"""Pillow's modes of 16-bit, 32-bit and floating point samples."""

PICTURES = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
"""Formats of images and masks: Pillow knows others, some of which start other programs."""


class _Bounded(io.BufferedReader):
    """A file of which no more is asked for than it has: Pillow asks for as much as a PNG's chunk states, up to 4 GB."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._bytes = os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """At most ``size`` bytes, all that are left without."""
        left = max(self._bytes - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


@contextmanager
def opened_image(path: Path) -> Iterator[Image.Image]:
    """An image file whose size and mode are known and whose pixels are not read yet.

    Raises:
        DatasetError: the file is missing, no image, or fails while it is read here.
    """
    try:
        with _Bounded(path) as file, Image.open(file, formats=PICTURES) as image:
            yield image
    except DatasetError:
        raise
    except Exception as error:  # a damaged image fails in any way it likes: the message must still name the file
        raise DatasetError(
            f"cannot read the image {path}: {shortened(error)}; expected a complete JPEG or PNG file, copy it again or "
            "delete it so that it counts as missing"
        ) from error


def read_image(path: Path, mode: str, size: tuple[int, int], words: str) -> np.ndarray:
    """An 8-bit image as a uint8 array, whole or not at all.

    Args:
        size: the height and width that it must state; only then its pixels are read.
        words: what says so, for the message.

    Raises:
        DatasetError: the file is missing, truncated, no image, of another size, or of more than 8 bits a channel.
    """
    with opened_image(path) as image:
        if (image.height, image.width) != size:
            raise DatasetError(f"{path} is {image.width}x{image.height} pixels, {words}")
        # Pillow clips wider samples to 0…255 without a word: 16 bits turn white, NaN turns black.
        if image.mode.startswith(WIDE_MODES):
            raise DatasetError(
                f"{path} holds wide samples (Pillow's mode {image.mode}), expected 8 bits a channel; convert it, "
                "with 65535 or 1.0 becoming 255"
            )
        return np.asarray(image.convert(mode))


def load_pixels(view: View, scale: float = 1.0) -> Pixels:
    """Reads a view's image and masks and removes the background.

    Masks are made disjoint (a pixel claimed by both goes to the person).  With ``scale`` below 1 the colours are area
    averages over the masked image, and a pixel belongs to a part when most of its area does.

    Raises:
        DatasetError: a file is damaged or the sizes of image, mask and camera differ.
    """
    height, width = size = (view.camera.height, view.camera.width)
    words = f"its calibration says {width}x{height}; use the images that belong to this calibration"
    rgb = read_image(view.image, "RGB", size, words)
    person, obj = (_read_mask(path, size, view) for path in (view.person_mask, view.object_mask))
    for path in view.held_masks:
        person = person | _read_mask(path, size, view)
    if view.lens is not None:
        rgb = view.lens.undistort(rgb, view.camera.intrinsics)
    obj = obj & ~person
    colour = np.where((person | obj)[..., None], rgb, 0).astype(np.float32) / 255.0
    if scale == 1.0:
        return Pixels(colour, person, obj)
    small = view.camera.scaled(scale)
    person_share, object_share = (_shrink(part.astype(np.float32), small) for part in (person, obj))
    inside = person_share + object_share > 0.5
    colour = np.stack([_shrink(colour[..., channel], small) for channel in range(3)], axis=-1)
    person = inside & (person_share >= object_share)
    return Pixels(np.where(inside[..., None], colour, 0.0).astype(np.float32), person, inside & ~person)


def _read_mask(path: Path | None, size: tuple[int, int], view: View) -> np.ndarray:
    if path is None:
        return np.zeros(size, dtype=bool)
    pixels = read_image(path, "RGBA" if view.masks.alpha else "L", size, f"its image {size[1]}x{size[0]}")
    mask = pixels[..., 3] if view.masks.alpha else pixels
    inside = mask > view.masks.above
    if view.lens is None:
        return inside
    return view.lens.undistort(inside.astype(np.uint8), view.camera.intrinsics, order=0) > 0


def _shrink(channel: np.ndarray, camera: Camera) -> np.ndarray:
    image = Image.fromarray(channel, mode="F")
    return np.asarray(image.resize((camera.width, camera.height), Image.Resampling.BOX))

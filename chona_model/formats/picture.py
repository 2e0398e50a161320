"""Pictures to look at: 8-bit sRGB PNG files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from chona_model.formats.atomic import atomic_path


def eight_bit(rgb: np.ndarray) -> np.ndarray:
    """[H, W, 3] uint8 of colours [H, W, 3], sRGB encoded: 0…1 becomes 0…255, rounded; beyond is clipped."""
    return np.round(np.clip(rgb, 0.0, 1.0) * 255.0).astype(np.uint8)


def save_picture(path: Path, rgb: np.ndarray) -> None:
    """Writes a PNG file, whole or not at all.

    Args:
        path: ends in ``.png``; its folder is made where it is missing.
        rgb: [H, W, 3] sRGB encoded; what lies outside 0…1 is clipped.

    Raises:
        WriteError: the folder cannot be made or written to, or the disk is full.
    """
    with atomic_path(path) as temporary:
        Image.fromarray(eight_bit(rgb)).save(temporary, format="PNG")

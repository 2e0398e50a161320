"""Lens distortion of real captures, taken out of images once when they are read.

The model is OpenCV's: with x = X/Z, y = Y/Z and r² = x² + y²,

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2 x²),   y' alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

NEGLIGIBLE = 1e-9
"""Coefficients up to this move no pixel that one could see."""


@dataclass(frozen=True)
class Lens:
    """Coefficients of Brown's model, the rational one where k4 … k6 are not zero."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    @staticmethod
    def opencv(coefficients: np.ndarray) -> Lens | None:
        """Of OpenCV's vector of 4, 5 or 8 coefficients (more must be zero: thin prism, tilt); None when all vanish.

        Raises:
            ValueError: another number of coefficients, or coefficients of a lens that this model does not have.
        """
        values = np.asarray(coefficients, dtype=np.float64).reshape(-1)
        if values.size not in (0, 4, 5, 8, 12, 14) or not np.isfinite(values).all():
            raise ValueError(f"{values.size} lens coefficients ({values.tolist()}), expected 4, 5 or 8 finite numbers")
        if np.abs(values[8:]).max(initial=0.0) > NEGLIGIBLE:
            raise ValueError("the lens has thin prism or tilt coefficients; undistort the images first")
        if np.abs(values).max(initial=0.0) <= NEGLIGIBLE:
            return None
        return Lens(*values[:8])

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the lens puts the ideal image point (x, y), both in focal lengths from the axis."""
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        radial = radial / (1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6)))
        return (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )

    def undistort(self, image: np.ndarray, intrinsics: np.ndarray, order: int = 1) -> np.ndarray:
        """The image that a pinhole camera with the same ``intrinsics`` takes; what it saw besides is black.

        Args:
            image: [H, W] or [H, W, C]; intrinsics: [3, 3], pixel centres at +0.5.
            order: 1 bilinear, 0 nearest (for labels).
        """
        height, width = image.shape[:2]
        columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        y = (rows - intrinsics[1, 2]) / intrinsics[1, 1]
        x = (columns - intrinsics[0, 2] - intrinsics[0, 1] * y) / intrinsics[0, 0]
        x, y = self.distort(x, y)
        where = [
            intrinsics[1, 1] * y + intrinsics[1, 2] - 0.5,
            intrinsics[0, 0] * x + intrinsics[0, 1] * y + intrinsics[0, 2] - 0.5,
        ]
        planes = image[..., None] if image.ndim == 2 else image
        taken = [
            map_coordinates(planes[..., k], where, order=order, mode="constant", output=image.dtype)
            for k in range(planes.shape[-1])
        ]
        return taken[0] if image.ndim == 2 else np.stack(taken, axis=-1)

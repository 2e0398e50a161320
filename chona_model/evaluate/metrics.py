"""Image metrics of the paper: PSNR and SSIM, on whole images and inside the masks' bounding box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from skimage.metrics import structural_similarity

SSIM_WINDOW = 11
SSIM_SIGMA = 1.5
IDENTICAL_PSNR = 100.0
"""dB reported for identical images, whose ratio has no finite value (a mean over images must stay finite)."""


@dataclass(frozen=True)
class Scores:
    """Metrics of one image; ``*_box`` inside the mask's bounding box, None where the mask is empty."""

    psnr: float
    ssim: float
    psnr_box: float | None
    ssim_box: float | None


def psnr(prediction: np.ndarray, target: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB of images in 0…1, over all pixels and channels."""
    _check(prediction, target)
    error = float(np.mean((prediction.astype(np.float64) - target.astype(np.float64)) ** 2))
    return IDENTICAL_PSNR if error <= 10.0 ** (-IDENTICAL_PSNR / 10.0) else float(-10.0 * np.log10(error))


def ssim(prediction: np.ndarray, target: np.ndarray) -> float:
    """Mean structural similarity of images [H, W, C] in 0…1: Gaussian window of 11 pixels, σ 1.5, data range 1.

    Images smaller than the window are padded by mirroring, so that a tiny box still has a value.
    """
    _check(prediction, target)
    pad = [(0, max(0, SSIM_WINDOW - size)) for size in target.shape[:2]] + [(0, 0)]
    mirrored = [np.pad(image.astype(np.float64), pad, mode="symmetric") for image in (prediction, target)]
    # scikit-image derives the window from truncate · σ: 3.5 · 1.5 rounds to a radius of 5, that is 11 pixels.
    return float(
        structural_similarity(
            *mirrored,
            gaussian_weights=True,
            sigma=SSIM_SIGMA,
            use_sample_covariance=False,
            data_range=1.0,
            channel_axis=-1,
        )
    )


def bounding_box(mask: np.ndarray) -> tuple[slice, slice] | None:
    """Rows and columns of the smallest box around a mask [H, W]; None when it is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def score(prediction: np.ndarray, target: np.ndarray, mask: np.ndarray) -> Scores:
    """All metrics of an image [H, W, 3] in 0…1 whose background is black outside ``mask`` [H, W]."""
    if mask.shape != target.shape[:2]:
        raise ValueError(f"the mask has the shape {mask.shape}, expected {target.shape[:2]}")
    box = bounding_box(mask)
    whole = psnr(prediction, target), ssim(prediction, target)
    if box is None:
        return Scores(*whole, None, None)
    return Scores(*whole, psnr(prediction[box], target[box]), ssim(prediction[box], target[box]))


def mean_of_known(values: Sequence[float | None]) -> float | None:
    """The mean of the values there are; None where there is none."""
    present = [value for value in values if value is not None]
    return float(np.mean(present)) if present else None


def _check(prediction: np.ndarray, target: np.ndarray) -> None:
    if prediction.shape != target.shape or target.ndim != 3:
        raise ValueError(f"images have the shapes {prediction.shape} and {target.shape}, expected one [H, W, C]")
    if not (np.isfinite(prediction).all() and np.isfinite(target).all()):
        raise ValueError("an image holds values that are not finite; expected 0 to 1")

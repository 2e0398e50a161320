"""Metrics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import correlate1d

from chona_model.evaluate.metrics import bounding_box, psnr, score, ssim


def _image(seed: int, size: int = 32) -> np.ndarray:
    return np.random.default_rng(seed).random((size, size, 3))


@pytest.mark.parametrize(("error", "expected"), [(0.1, 20.0), (0.01, 40.0), (1.0, 0.0), (0.0, 100.0)])
def test_psnr_of_a_constant_error(error: float, expected: float) -> None:
    target = np.zeros((8, 8, 3), dtype=np.float32)
    assert psnr(target + error, target) == pytest.approx(expected, abs=1e-4)


def test_ssim_of_constant_images() -> None:
    a, b, c1 = 0.3, 0.6, 0.01**2
    expected = (2 * a * b + c1) / (a * a + b * b + c1)
    assert ssim(np.full((20, 20, 3), a), np.full((20, 20, 3), b)) == pytest.approx(expected, abs=1e-12)


def test_ssim_is_the_papers_formula_with_a_window_of_eleven() -> None:
    x, y = _image(1), _image(2)
    kernel = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    kernel /= kernel.sum()

    def blur(image: np.ndarray) -> np.ndarray:
        return correlate1d(correlate1d(image, kernel, axis=0), kernel, axis=1)[5:-5, 5:-5]

    mx, my = blur(x), blur(y)
    vx, vy, vxy = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    expected = ((2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))).mean()
    assert ssim(x, y) == pytest.approx(expected, abs=1e-10)


def test_identical_images_score_one() -> None:
    assert ssim(_image(1), _image(1)) == pytest.approx(1.0)


def test_the_box_is_scored_apart() -> None:
    target, mask = np.zeros((40, 40, 3)), np.zeros((40, 40), dtype=bool)
    mask[10:30, 5:15] = True
    prediction = target + 0.1 * mask[..., None]
    scores = score(prediction, target, mask)
    assert scores.psnr_box == pytest.approx(20.0)
    assert scores.psnr == pytest.approx(20.0 - 10 * np.log10(200 / 1600))
    assert scores.ssim_box is not None
    assert scores.ssim_box < scores.ssim < 1.0


def test_an_empty_mask_has_no_box() -> None:
    scores = score(_image(1), _image(2), np.zeros((32, 32), dtype=bool))
    assert (scores.psnr_box, scores.ssim_box) == (None, None)


@pytest.mark.parametrize("size", [1, 5, 11])
def test_a_box_smaller_than_the_window_still_scores(size: int) -> None:
    assert ssim(_image(1, size), _image(1, size)) == pytest.approx(1.0)


def test_bounding_box_holds_the_mask_tightly() -> None:
    mask = np.zeros((6, 8), dtype=bool)
    mask[2, 3] = mask[4, 6] = True
    assert bounding_box(mask) == (slice(2, 5), slice(3, 7))


def test_unequal_or_broken_images_are_refused() -> None:
    with pytest.raises(ValueError, match=r"have the shapes \(32, 32, 3\) and \(16, 16, 3\)"):
        psnr(_image(1), _image(1, 16))
    with pytest.raises(ValueError, match="not finite"):
        ssim(np.full((12, 12, 3), np.nan), np.zeros((12, 12, 3)))

"""Lens distortion against points projected through it, and against a numeric inverse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.optimize import root

from chona_model.camera import Camera
from chona_model.data.dataset import MaskRule, Pose, View
from chona_model.data.images import load_pixels
from chona_model.data.lens import Lens

INTRINSICS = np.array([[200.0, 0.0, 100.5], [0.0, 190.0, 70.5], [0.0, 0.0, 1.0]])
RADIAL = Lens(k1=-0.25, k2=0.08, p1=0.004, p2=-0.003, k3=-0.01)
RATIONAL = Lens(k1=0.45, k2=-2.6, p1=0.0005, p2=-0.0003, k3=1.5, k4=0.33, k5=-2.42, k6=1.43)
"""Like a Kinect's."""


def spot(width: int, height: int, centre: np.ndarray) -> np.ndarray:
    """A Gaussian of 3 pixels' width around ``centre``, pixel centres at +0.5."""
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.exp(-((columns - centre[0]) ** 2 + (rows - centre[1]) ** 2) / 18.0)


def centroid(image: np.ndarray) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(image.shape[1]) + 0.5, np.arange(image.shape[0]) + 0.5)
    return np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()


@pytest.mark.parametrize("lens", [RADIAL, RATIONAL])
@pytest.mark.parametrize("point", [(0.0, 0.0), (0.3, 0.2), (-0.35, 0.25), (0.2, -0.3)])
def test_a_distorted_point_comes_back_to_where_a_pinhole_sees_it(lens: Lens, point: tuple[float, float]) -> None:
    x, y = lens.distort(*np.array(point))
    seen = INTRINSICS[:2, :2] @ np.array([x, y]) + INTRINSICS[:2, 2]
    restored = lens.undistort(spot(200, 140, seen).astype(np.float64), INTRINSICS)
    ideal = INTRINSICS[:2, :2] @ np.array(point) + INTRINSICS[:2, 2]
    assert np.abs(centroid(restored) - ideal).max() < 0.15  # a stretched Gaussian's mean is not quite its centre


@pytest.mark.parametrize("lens", [RADIAL, RATIONAL])
def test_distortion_has_the_inverse_that_a_solver_finds(lens: Lens) -> None:
    for ideal in np.random.default_rng(1).uniform(-0.4, 0.4, (20, 2)):
        target = np.array(lens.distort(*ideal))
        found = root(lambda p, t=target: np.array(lens.distort(p[0], p[1])) - t, target)
        assert found.success and np.abs(found.x - ideal).max() < 1e-6


def test_coefficients_of_opencv_are_read_in_its_order() -> None:
    assert Lens.opencv(np.array([1, 2, 3, 4])) == Lens(k1=1, k2=2, p1=3, p2=4)
    assert Lens.opencv(np.array([[1], [2], [3], [4], [5]])) == Lens(k1=1, k2=2, p1=3, p2=4, k3=5)
    assert Lens.opencv(np.arange(1, 9)) == Lens(1, 2, 3, 4, 5, 6, 7, 8)
    assert Lens.opencv(np.zeros(5)) is None and Lens.opencv(np.zeros(0)) is None


def test_other_lenses_are_refused() -> None:
    with pytest.raises(ValueError, match=r"3 lens coefficients.*expected 4, 5 or 8"):
        Lens.opencv(np.ones(3))
    with pytest.raises(ValueError, match="thin prism or tilt"):
        Lens.opencv(np.array([0.1] * 12))
    with pytest.raises(ValueError, match="finite"):
        Lens.opencv(np.array([0.1, np.nan, 0, 0]))


def test_image_and_mask_of_a_view_are_undistorted_alike(tmp_path: Path) -> None:
    seen = INTRINSICS[:2, :2] @ np.array(RADIAL.distort(*np.array([0.3, 0.2]))) + INTRINSICS[:2, 2]
    shown = spot(200, 140, seen)
    Image.fromarray((shown * 255).astype(np.uint8)).convert("RGB").save(tmp_path / "image.png")
    Image.fromarray((shown > 0.2).astype(np.uint8) * 4).save(tmp_path / "mask.png")
    camera = Camera(INTRINSICS, np.eye(4), 200, 140)
    pose = Pose("somebody", (), np.eye(4)[None], np.empty((0, 4, 4)))
    files = (tmp_path / "image.png", tmp_path / "mask.png")
    view = View("one", "0", "only", camera, pose, *files, masks=MaskRule(above=0), lens=RADIAL)
    pixels = load_pixels(view)
    ideal = INTRINSICS[:2, :2] @ np.array([0.3, 0.2]) + INTRINSICS[:2, 2]
    assert np.abs(centroid(pixels.person.astype(float)) - ideal).max() < 0.5
    assert np.abs(centroid(pixels.rgb[..., 0]) - ideal).max() < 0.5

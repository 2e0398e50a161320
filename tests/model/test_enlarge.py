"""Pictures rendered small and interpolated: the box that shows anything, as the whole would be."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from chona_model.actor import EMPTY_DEPTH, Picture, empty_picture
from chona_model.camera import Camera
from chona_model.upsampling import enlarge


def camera(width: int, height: int) -> Camera:
    return Camera(np.diag([50.0, 50.0, 1.0]), np.eye(4), width, height)


def blot(width: int, height: int) -> Picture:
    """A small random thing on nothing."""
    picture, random = empty_picture(camera(width, height)), np.random.default_rng(0)
    where = np.s_[5:11, 20:26]
    for name in ("alpha", "human", "object", "confidence"):
        getattr(picture, name)[where] = random.random((6, 6))
    picture.rgb[where] = random.random((6, 6, 3))
    picture.depth[where] = 2.0 + random.random((6, 6))
    return picture


@pytest.mark.parametrize("size", [(96, 72), (64, 48), (75, 50)])
def test_interpolated_in_its_box_as_if_whole(size: tuple[int, int]) -> None:
    """``size`` is twice, four thirds and no simple multiple of the small picture's."""
    small = blot(48, 36)
    large = enlarge(small, camera(*size))
    linear = Image.Resampling.BILINEAR
    for name in ("alpha", "human", "object", "confidence"):
        whole = np.asarray(Image.fromarray(getattr(small, name)).resize(size, linear))
        np.testing.assert_allclose(getattr(large, name), whole, atol=1e-6, err_msg=name)
    for k in range(3):
        whole = np.asarray(Image.fromarray(np.ascontiguousarray(small.rgb[..., k])).resize(size, linear))
        np.testing.assert_allclose(large.rgb[..., k], whole, atol=1e-6)
    nearest = np.asarray(Image.fromarray(small.depth).resize(size, Image.Resampling.NEAREST))
    np.testing.assert_array_equal(large.depth, np.where(large.alpha > 0, nearest, np.float32(EMPTY_DEPTH)))
    assert large.alpha.max() > 0.5


def test_an_empty_picture_stays_empty() -> None:
    large = enlarge(empty_picture(camera(10, 8)), camera(20, 16))
    assert not large.alpha.any()
    assert (large.depth == EMPTY_DEPTH).all()
    assert (large.confidence == 1.0).all()


def test_what_touches_the_border_is_kept_whole() -> None:
    small = empty_picture(camera(10, 8))
    small.alpha[:] = 1.0
    assert (enlarge(small, camera(20, 16)).alpha == 1.0).all()

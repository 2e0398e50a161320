"""Motion blur and depth of field against closed forms: a card that moves, turns, and is out of focus."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blur_scenes import Card, Motion, a_lens, at, card_shot, shutter_times

from chona_model.actor import EMPTY_DEPTH
from chona_model.blur import SHARP, Blur, BlurChoice, aperture_point, groups_of, plan_takes
from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.formats.exr import FrameLayers
from chona_model.formats.shot import Shot, ShotError
from chona_model.frame import ShotRenderer
from chona_model.settings import RENDER_PRESETS

PREVIEW = RENDER_PRESETS["preview"]


def rendered(shot: Shot, card: Card, samples: int = 16, **changes: object) -> FrameLayers:
    blur = Blur(shot.shutter is not None, shot.lens is not None, samples)
    settings = replace(PREVIEW, **changes)  # type: ignore[arg-type]
    return ShotRenderer([card], shot, settings, blur=blur).render(0)  # type: ignore[list-item]


def block_mean(picture: np.ndarray, side: int = 4) -> np.ndarray:
    """Means of blocks of pixels as large as the tile of the groups."""
    height, width = picture.shape
    return picture.reshape(height // side, side, width // side, side).mean(axis=(1, 3))


# Motion

WIDE = (10.0, 10.0)
SPEED = 0.4
"""Metres a frame; at 2 m and a focal length of 100 pixels 20 pixels a frame."""


def sweep(time: float) -> np.ndarray:
    """A half plane whose right edge passes the picture's middle at time 0."""
    return at(-10.0 + SPEED * time, 0.0, 2.0)


@pytest.mark.parametrize(("opens", "closes"), [(-0.25, 0.25), (0.0, 0.5), (-1.0, 0.0)])
def test_a_moving_edge_is_the_integral_of_pixel_and_shutter(opens: float, closes: float) -> None:
    """Coverage of a pixel at column c is the mean over the shutter of clamp(edge(t) − c, 0, 1)."""
    shot = card_shot(sweep, times=shutter_times(128, opens, closes))
    alpha = rendered(shot, Card(WIDE), samples=64).combined[..., 3]
    edges = 32.0 + 20.0 * np.linspace(opens, closes, 4001)
    exact = np.clip(edges[:, None] - np.arange(64), 0.0, 1.0).mean(axis=0)
    assert np.abs(alpha - exact).max() <= 2.0 / 64, "a sample at either side of a pixel"
    blocks = np.tile(exact, (48, 1))
    assert np.abs(block_mean(alpha) - block_mean(blocks)).max() <= 1.0 / 64


def test_a_turning_edge_covers_the_share_of_the_angle() -> None:
    """A half plane turns 60 degrees about the middle: coverage goes linearly with the pixel's angle."""
    turn = np.pi / 3

    def spin(time: float) -> np.ndarray:
        return at(0.0, 0.0, 2.0, turn * time) @ at(0.0, 10.0)

    shot = card_shot(spin, times=shutter_times(64, -0.5, 0.5))
    alpha = rendered(shot, Card(WIDE), samples=32).combined[..., 3]
    x, y = np.meshgrid(np.arange(64) + 0.5 - 32, np.arange(48) + 0.5 - 24)
    right = (x > 8) & (np.hypot(x, y) < 24)
    exact = np.clip(0.5 + np.arctan2(y, x) / turn, 0.0, 1.0)
    # A pixel's box smooths the corners of the ramp over its own angle.
    error = np.abs(alpha - exact)[right]
    assert error.max() <= 1.6 / 32 + 0.06 and error.mean() < 0.01


def test_a_moving_camera_is_a_world_that_moves_the_other_way() -> None:
    times = shutter_times(16, -0.5, 0.5)
    still, lens = at(0.1, 0.0, 2.0), a_lens(1.5, 0.02)
    by_camera = card_shot(lambda _: still, camera=lambda time: at(SPEED * time), times=times, lens=lens)
    by_card = card_shot(lambda time: at(-SPEED * time) @ still, times=times, lens=lens)
    card = Card((0.1, 0.1), 0.5)
    one, other = rendered(by_camera, card), rendered(by_card, card)
    np.testing.assert_allclose(one.combined, other.combined, atol=1e-6)
    assert (one.combined[..., 3] % 1 > 0).sum() > 0


def test_neighbours_fill_the_gaps_between_a_pixels_moments() -> None:
    """A bar of one pixel flies 48 pixels: eight samples alone are eight ghosts; of a block they are a streak."""
    motion: Motion = lambda time: at(0.96 * time, 0.0, 2.0)  # noqa: E731
    bar = Card((0.02, 10.0))
    streak = block_mean(rendered(card_shot(motion, times=shutter_times(16, -0.5, 0.5)), bar, 8).combined[..., 3])
    ghosts = block_mean(rendered(card_shot(motion, times=shutter_times(8, -0.5, 0.5)), bar, 8).combined[..., 3])
    inside = slice(3, -3)
    spread = [np.ptp(each[:, inside]) / each[:, inside].mean() for each in (streak, ghosts)]
    assert spread[0] < 0.6 * spread[1], spread


def test_a_moments_pose_is_asked_for_in_one_run() -> None:
    """However many points of the lens: that is what making a pose ready once relies on."""
    card = Card((0.1, 0.1))
    rendered(card_shot(sweep, times=shutter_times(16, -0.5, 0.5), lens=a_lens(1.0, 0.01)), card, 8)
    assert len(card.seen) == 16
    assert card.rays == 8 * 64 * 48


def test_more_samples_come_nearer() -> None:
    shot = card_shot(sweep, times=shutter_times(256, -0.5, 0.5), lens=a_lens(1.0, 0.05))
    best = rendered(shot, Card(WIDE), 256).combined[..., 3]
    errors = [np.sqrt(((rendered(shot, Card(WIDE), n).combined[..., 3] - best) ** 2).mean()) for n in (4, 16, 64)]
    assert errors[0] > 2 * errors[1] > 4 * errors[2], errors


# The lens

FOCUS, DEPTH, RADIUS = 2.0, 5.0, 0.1


def spread(alpha: np.ndarray) -> np.ndarray:
    """Standard deviations of a spot along x and y, pixels."""
    x, y = np.meshgrid(np.arange(alpha.shape[1]) + 0.5, np.arange(alpha.shape[0]) + 0.5)
    share = alpha / alpha.sum()
    middle = (share * x).sum(), (share * y).sum()
    return np.sqrt([(share * (x - middle[0]) ** 2).sum(), (share * (y - middle[1]) ** 2).sum()])


@pytest.mark.parametrize(("blades", "ratio"), [(0, 1.0), (0, 2.0), (4, 1.0), (6, 0.5)])
@pytest.mark.parametrize("kind", ["PERSP", ORTHOGRAPHIC])
def test_a_point_becomes_the_apertures_shape_of_the_right_size(blades: int, ratio: float, kind: str) -> None:
    """Second moments: a disc has r²/4 along each axis; a regular polygon r² (1 − 2 sin²(π/n) / 3) / 4."""
    # Thin lens, pixels; at depth z an orthographic one's point moves by radius · |1 − z / focus|.
    flat, focal = kind == ORTHOGRAPHIC, 80.0 if kind == ORTHOGRAPHIC else 400.0
    size = focal * RADIUS * abs(1.0 - DEPTH / FOCUS if flat else 1 / FOCUS - 1 / DEPTH)
    half = 3.0 / focal if flat else 3.0 * DEPTH / focal  # a spot of six pixels: one alone would take few samples
    shot = card_shot(
        lambda _: at(0.0, 0.0, DEPTH), lens=a_lens(FOCUS, RADIUS, blades, 0.3, ratio), kind=kind, focal=focal
    )
    alpha = rendered(shot, Card((half, half)), 64).combined[..., 3]
    inside = 1.0 if blades < 3 else 1.0 - 2.0 / 3.0 * np.sin(np.pi / blades) ** 2
    own = (6.0**2 + 1.0) / 12.0  # the spot and the pixel, boxes
    expected = np.sqrt(0.25 * size**2 * inside / np.array([ratio**2, 1.0]) + own)
    np.testing.assert_allclose(spread(alpha), expected, rtol=0.03)


def test_the_blades_turn_against_the_clock() -> None:
    """A triangle's corners where Cycles has them: at the rotation and every third of a turn, y up."""
    random = np.random.default_rng(0)
    points = np.array([aperture_point(place, 3, 0.2, 1.0) for place in random.random((4000, 2))])
    for third in range(3):
        angle = 0.2 - np.pi / 3 + (third + 1) * 2 * np.pi / 3
        reach = points @ [np.cos(angle), np.sin(angle)]
        assert 0.93 < reach.max() <= 1.0 + 1e-9
    assert (points @ [np.cos(0.2), np.sin(0.2)]).max() <= 0.5 + 1e-9, "half the radius to the sides"


@pytest.mark.parametrize("kind", ["PERSP", ORTHOGRAPHIC])
def test_what_is_in_focus_stays_sharp_and_where_it_is(kind: str) -> None:
    shot = card_shot(
        lambda _: at(0.11, 0.07, FOCUS), lens=a_lens(FOCUS, 0.3), kind=kind, focal=100.0 if kind == "PERSP" else 50.0
    )
    card = Card((0.2, 0.2))
    blurred = rendered(shot, card, 64).combined[..., 3]
    sharp = rendered(replace(shot, lens=None), card, supersampling=8).combined[..., 3]
    assert np.abs(blurred - sharp).max() < 0.08
    assert ((blurred > 0) == (sharp > 0)).mean() > 0.999


def test_an_orthographic_lens_is_an_oblique_projection() -> None:
    """u = f (x − p (1 − z / focus)) + c for points anywhere, exactly, by an independent formula."""
    random = np.random.default_rng(1)
    turned = at(0.3, -0.2, 1.0, 0.7)
    camera = Camera(np.array([[50.0, 0, 30.0], [0, 40.0, 20.0], [0, 0, 1]]), turned, 64, 48, ORTHOGRAPHIC)
    points = random.normal(0, 1, (20, 3)) + [0, 0, 4]
    for point in random.normal(0, 0.3, (5, 2)):
        moved = camera.through(point, 3.0)
        u, _ = moved.project(points @ turned[:3, :3].T + turned[:3, 3])
        expected = (points[:, :2] - point * (1 - points[:, 2:] / 3.0)) * [50.0, 40.0] + [30.0, 20.0]
        np.testing.assert_allclose(u, expected, atol=1e-9)
        rotation = moved.world_from_camera[:3, :3]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) > 0 and moved.intrinsics[1, 0] == 0


# What is not colour


def test_depth_is_that_of_the_frames_own_time_and_mattes_follow_alpha() -> None:
    """A card that comes nearer by 2 m a frame: 2 m at its own time, however blurred; the mean would be another."""
    shot = card_shot(lambda time: at(0.3 * time, 0.0, 2.0 - 2.0 * time), times=shutter_times(32, 0.0, 0.5))
    layers = rendered(shot, Card((0.2, 0.2)))
    alpha = layers.combined[..., 3]
    assert layers.depth is not None and layers.object is not None and layers.confidence is not None
    np.testing.assert_allclose(layers.depth[24, 32], 2.0, atol=0.04)
    assert ((layers.depth < EMPTY_DEPTH) == (alpha > 0)).all()
    np.testing.assert_allclose(layers.object, alpha, atol=1e-6)
    assert ((alpha > 0.05) & (alpha < 0.95)).sum() > 20
    np.testing.assert_array_equal(layers.confidence, 1.0)


def test_colours_are_averaged_in_linear_light() -> None:
    """Grey sRGB 0.5 over half the samples is its linear value times alpha: premultiplied, whatever the coverage."""
    layers = rendered(card_shot(sweep, times=shutter_times(32, -0.5, 0.5)), Card(WIDE, 0.5))
    linear = ((0.5 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(layers.combined[..., 0], linear * layers.combined[..., 3], atol=1e-6)


def test_a_share_of_the_resolution_is_blurred_there() -> None:
    shot = card_shot(sweep, times=shutter_times(32, -0.5, 0.5))
    whole, half = Card(WIDE), Card(WIDE)
    full = rendered(shot, whole).combined[..., 3]
    small = rendered(shot, half, resolution=0.5).combined[..., 3]
    assert half.rays == whole.rays / 4
    assert np.abs(block_mean(full) - block_mean(small)).max() < 0.12


# Off


def test_what_does_not_blur_costs_and_shows_what_it_did() -> None:
    """A still scene with the shutter open and the lens stopped down is the sharp frame, ray for ray."""
    still: Motion = lambda _: at(0.1, 0.0, 2.0)  # noqa: E731
    plain, open_ = Card((0.2, 0.2), 0.5), Card((0.2, 0.2), 0.5)
    sharp = rendered(card_shot(still), plain, supersampling=2)
    blurred = rendered(
        card_shot(still, times=shutter_times(16, -0.5, 0.5), lens=a_lens(2.0, 0.0)), open_, supersampling=2
    )
    np.testing.assert_array_equal(sharp.combined, blurred.combined)
    np.testing.assert_array_equal(sharp.depth, blurred.depth)
    assert plain.rays == open_.rays == 4 * 64 * 48


def test_a_choice_takes_of_the_shot_what_it_has() -> None:
    moving, focused = card_shot(sweep, times=np.array([0.0])), card_shot(sweep, lens=a_lens(1.0, 0.1))
    both = replace(moving, lens=focused.lens, blur_samples=5)
    assert BlurChoice().of(card_shot(sweep)) == SHARP
    assert BlurChoice().of(moving) == Blur(True, False)
    assert BlurChoice().of(both) == Blur(True, True, 5)
    assert BlurChoice("off", "on", 7).of(both) == Blur(False, True, 7)
    assert BlurChoice("off", "off", 7).of(both) == SHARP
    with pytest.raises(ShotError, match=r"holds no depth of field; .* or leave --depth-of-field out"):
        BlurChoice(focus="on").of(moving)


@pytest.mark.parametrize("samples", [1, 3, 8, 16, 100])
@pytest.mark.parametrize("times", [0, 1, 5, 16, 32, 300])
@pytest.mark.parametrize("focus", [True, False])
def test_every_pixel_gets_its_samples_spread_over_the_shutter(samples: int, times: int, focus: bool) -> None:
    takes = plan_takes(samples, times, focus)
    groups = {take.group for take in takes}
    assert groups == set(range(len(groups)))
    assert set(np.unique(groups_of(4, 4, len(groups)))) == groups
    for group in groups:
        own = [take for take in takes if take.group == group]
        assert len(own) == samples
        if times:
            seen = np.bincount([take.time for take in own if take.time is not None], minlength=times)
            assert seen.max() - seen.min() <= 1
    assert np.abs([take.pixel for take in takes]).max() <= 0.5

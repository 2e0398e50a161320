"""Motion blur and depth of field: when and through which point of the lens the rays of which pixels go.

A blurred picture is the mean of many sharp ones, which alone would show as many ghosts. So the pixels are dealt to
classes like the squares of a chess board, and each class has moments, points of the lens and points of the pixel of its
own: what one pixel lacks its neighbours have. A moment's pose is made ready once for all that see it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from chona_model.actor import EMPTY_DEPTH, Picture, empty_picture
from chona_model.camera import Camera
from chona_model.formats.shot import Shot, ShotError

DEFAULT_SAMPLES = 16
"""Rays a pixel where the scene does not say."""

TILE = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])
"""Bayer's order of a tile's pixels: the first half of them are every other one, and so on."""

LENS_CLASSES = 4
"""Points of the lens at every moment where both blur: more share a moment's pose, but every one is a picture more."""

_STEPS = 1.0 / np.array([1.1673039782614187]) ** np.arange(1, 5)
"""Additive recurrence in four dimensions (Roberts 2018): any run of its points covers them evenly; g⁵ = g + 1."""


@dataclass(frozen=True)
class Blur:
    """What blurs a frame.

    Attributes:
        motion: what moves while the shutter is open; focus: what lies out of focus.
        samples: rays a pixel.
    """

    motion: bool = False
    focus: bool = False
    samples: int = DEFAULT_SAMPLES


SHARP = Blur()


@dataclass(frozen=True)
class Take:
    """One sharp picture among those that are averaged.

    Attributes:
        group: of the pixels it is rendered for.
        time: position in the shutter's times; None: the frame's own time.
        lens: [2] point of the unit square that the lens is sampled over; pixel: [2] from a pixel's centre, −½…½.
    """

    group: int
    time: int | None
    lens: np.ndarray
    pixel: np.ndarray


@dataclass(frozen=True)
class BlurChoice:
    """What of a shot is asked to blur.

    Attributes:
        motion, focus: of ``settings.BLURS``; samples: rays a pixel, None for what the shot says.
    """

    motion: str = "shot"
    focus: str = "shot"
    samples: int | None = None

    def of(self, shot: Shot) -> Blur:
        """What blurs in a shot.

        Raises:
            ShotError: a blur is asked for that the shot has nothing of.
        """
        held = {"motion blur": shot.shutter is not None, "depth of field": shot.lens is not None}
        for (name, there), mode in zip(held.items(), (self.motion, self.focus), strict=True):
            if mode == "on" and not there:
                raise ShotError(
                    f"the shot '{shot.name}' holds no {name}; switch it on in the scene and in the Bake panel and "
                    f"write the shot again, or leave --{name.replace(' ', '-')} out"
                )
        chosen = shot.shutter is not None and self.motion != "off", shot.lens is not None and self.focus != "off"
        return Blur(*chosen, self.samples or shot.blur_samples or DEFAULT_SAMPLES) if any(chosen) else SHARP


AS_IN_THE_SHOT = BlurChoice()


def blur_of_frame(shot: Shot, index: int, blur: Blur) -> Blur:
    """What blurs one frame: where nothing moves and nothing lies behind an aperture it is sharp, and costs no more."""
    motion = blur.motion and shot.shutter is not None and _moves(shot, index)
    focus = blur.focus and shot.lens is not None and bool(shot.lens.radius[index] > 0.0)
    return replace(blur, motion=motion, focus=focus) if motion or focus else SHARP


def rays_of_pixel(blur: Blur, sharp: int) -> int:
    """How many rays a pixel of a frame takes: never fewer than the ``sharp`` one's."""
    return max(blur.samples, sharp) if blur.motion or blur.focus else sharp


def _moves(shot: Shot, index: int) -> bool:
    own = shot.shutter
    assert own is not None
    arrays = (own.intrinsics, own.world_from_camera, *own.world_from_bone, *own.world_from_object)
    return any((array[index] != array[index, :1]).any() for array in arrays)


def plan_takes(samples: int, times: int, focus: bool) -> list[Take]:
    """The pictures that make a blurred one, those of one moment after another.

    Every pixel gets ``samples`` of them, at moments spread evenly over the shutter's.

    Args:
        times: of the shutter; 0 where nothing moves.
    """
    of_times = 1
    while 2 * of_times * samples <= times and 2 * of_times <= TILE.size:
        of_times *= 2
    groups = of_times
    if focus:
        groups = TILE.size if not times else min(TILE.size, of_times * LENS_CLASSES)
    takes = []
    for group in range(groups):
        for number in range(samples):
            point = (0.5 + (group * samples + number + 1) * _STEPS) % 1.0
            part = (number + (group * of_times // groups + 0.5) / of_times) / samples
            takes.append(Take(group, int(part * times) if times else None, point[:2], point[2:] - 0.5))
    return sorted(takes, key=lambda take: take.time or 0)


def groups_of(height: int, width: int, count: int) -> np.ndarray:
    """[height, width] which of ``count`` groups every pixel is of."""
    side = len(TILE)
    tiled = np.tile(TILE * count // TILE.size, (-(-height // side), -(-width // side)))
    return tiled[:height, :width]


def aperture_point(place: np.ndarray, blades: int, rotation: float, ratio: float) -> np.ndarray:
    """[2] right and up, in radii of the aperture, for ``place`` [2] in the unit square; areas stay in proportion.

    A circle, or a polygon with its corners on it, as Cycles samples them.

    Args:
        blades: corners, fewer than 3 for a circle; rotation: radians; ratio: height over width.
    """
    u, v = place
    if blades < 3:
        angle = 2.0 * np.pi * v
        point = np.sqrt(u) * np.array([np.cos(angle), np.sin(angle)])
    else:
        corner = np.floor(u * blades)
        away = np.sqrt(u * blades - corner)
        along = v * away
        half, turn = np.pi / blades, rotation + corner * 2.0 * np.pi / blades
        x, y = (1.0 - away + along) * np.cos(half), (1.0 - away - along) * np.sin(half)
        point = np.array([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y])
    return point / np.array([ratio, 1.0])


def take_camera(shot: Shot, index: int, take: Take, camera: Camera, focus: bool) -> Camera:
    """``camera``, the frame's at the take's moment, through the take's point of the lens and of the pixels."""
    if focus:
        lens = shot.lens
        assert lens is not None
        point = aperture_point(
            take.lens, int(lens.blades[index]), float(lens.rotation[index]), float(lens.ratio[index])
        )
        camera = camera.through(lens.radius[index] * point * (1.0, -1.0), float(lens.focus_distance[index]))
    return camera.shifted(take.pixel)


def mean_picture(
    takes: Sequence[Take], render: Callable[[Take, np.ndarray], Picture], camera: Camera, samples: int,
    pixels: np.ndarray | None, distance: Callable[[Take], float],
) -> Picture:  # fmt: skip
    """The mean of pictures, each rendered for its own pixels.

    Colours, alpha, mattes and normals are means, weighted as they are; so is confidence. A pixel's depth is that of a
    single picture, the one of the least ``distance`` that shows anything: a mean would lie between things.

    Args:
        render: one take's picture, scene-linear, for some pixels [H, W] bool.
        camera: whose size the picture has; samples: takes of a pixel.
        pixels: [H, W] bool those that are wanted, None for all.
        distance: of a take from the frame's own time and the centre of the lens.
    """
    groups = groups_of(camera.height, camera.width, 1 + max(take.group for take in takes))
    mean, nearest, rays, failed = None, np.full(groups.shape, np.inf), 0, 0.0
    for take in takes:
        wanted = groups == take.group
        found = render(take, wanted if pixels is None else wanted & pixels)
        mean = mean or _blank(found, camera)
        rays += found.rays
        failed += found.failed_share * found.rays
        at = np.nonzero(found.alpha > 0)
        for name, channel in found.channels.items():
            if name not in ("depth", "confidence"):
                getattr(mean, name)[at] += channel[at] / samples
        unsure = np.nonzero(found.confidence < 1)
        mean.confidence[unsure] -= (1.0 - found.confidence[unsure]) / samples
        nearer = distance(take) < nearest[at]
        closer = tuple(axis[nearer] for axis in at)
        mean.depth[closer], nearest[closer] = found.depth[closer], distance(take)
    assert mean is not None  # there is a take at least
    return replace(mean, rays=rays, failed_share=failed / max(rays, 1))


def _blank(like: Picture, camera: Camera) -> Picture:
    blank: dict[str, Any] = {name: np.zeros_like(channel) for name, channel in like.channels.items()}
    blank |= {"depth": np.full_like(like.depth, EMPTY_DEPTH), "confidence": np.ones_like(like.confidence)}
    return replace(empty_picture(camera), **blank)

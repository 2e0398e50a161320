"""Shots of an analytic actor, a card, whose blur is known in closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from chona_model.actor import EMPTY_DEPTH, Picture, empty_picture
from chona_model.camera import Camera
from chona_model.data.dataset import Pose
from chona_model.formats.shot import Lens, Shot, ShotActor, Shutter
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.settings import RenderSettings

Motion = Callable[[float], np.ndarray]
"""Time in frames → [4, 4] the card's frame in the world."""


class Card:
    """An opaque rectangle in the plane z = 0 of its object's frame, traced ray by ray.

    Attributes:
        rays: traced in all; seen: the object frames it was asked for, each run of the same once.

    Args:
        half: half its width and height, metres; grey: its colour, sRGB.
    """

    kind = "card"

    def __init__(self, half: tuple[float, float], grey: float = 1.0) -> None:
        self.half, self.grey = np.array(half), grey
        self.rays = 0
        self.seen: list[np.ndarray] = []

    def render(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None = None,
        _passes: Passes = DEFAULT_PASSES,
    ) -> Picture:  # fmt: skip
        picture, side = empty_picture(camera), settings.supersampling
        wanted = np.nonzero(np.ones((camera.height, camera.width), bool) if pixels is None else pixels)
        if not self.seen or (self.seen[-1] != pose.world_from_object[0]).any():
            self.seen.append(pose.world_from_object[0])
        self.rays += len(wanted[0]) * side**2
        own = pose.world_from_object[0]
        corners = np.stack(wanted[::-1], axis=-1).astype(np.float64)
        for sub in range(side**2):
            origins, directions = camera.rays(corners + (np.array([sub % side, sub // side]) + 0.5) / side)
            begin, along = (origins - own[:3, 3]) @ own[:3, :3], directions @ own[:3, :3]
            depth = -begin[:, 2] / along[:, 2]
            inside = (depth > 0) & (np.abs((begin + depth[:, None] * along)[:, :2]) <= self.half).all(axis=-1)
            at = tuple(axis[inside] for axis in wanted)
            picture.alpha[at] += 1.0 / side**2
            picture.depth[at] = depth[inside]
        picture.rgb[:] = self.grey * picture.alpha[..., None]
        picture.object[:] = picture.alpha
        picture.depth[picture.alpha == 0] = EMPTY_DEPTH
        return picture


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0, turned: float = 0.0) -> np.ndarray:
    """A frame at a place, turned about z, radians."""
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]
    matrix[:3, 3] = x, y, z
    return matrix


def card_shot(
    card: Motion, *, camera: Motion = lambda _: np.eye(4), focal: float = 100.0, size: tuple[int, int] = (64, 48),
    times: np.ndarray | None = None, lens: Lens | None = None, kind: str = "PERSP",
) -> Shot:  # fmt: skip
    """A shot of one frame, 0, with the card and the camera moved as told; the camera looks along +z."""
    width, height = size
    intrinsics = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    actor = ShotActor("card", None, ("card",), (), np.zeros((1, 0, 4, 4)), card(0.0)[None, None])
    shutter = None
    if times is not None:
        moments = [(camera(time), card(time)) for time in times]
        shutter = Shutter(
            times, np.broadcast_to(intrinsics, (1, len(times), 3, 3)), np.stack([one for one, _ in moments])[None],
            (np.zeros((1, len(times), 0, 4, 4)),), (np.stack([one for _, one in moments])[None, :, None],),
        )  # fmt: skip
    return Shot(
        "card", 24.0, width, height, kind, np.zeros(1, np.int64), intrinsics[None], camera(0.0)[None],
        np.array([[0.01, 100.0]]), (actor,), shutter=shutter, lens=lens,
    )  # fmt: skip


def a_lens(focus: float, radius: float, blades: int = 0, rotation: float = 0.0, ratio: float = 1.0) -> Lens:
    """The lens of one frame."""
    return Lens(*(np.array([float(value)]) for value in (focus, radius, blades, rotation, ratio)))


def shutter_times(count: int, opens: float, closes: float) -> np.ndarray:
    """Middles of ``count`` even parts."""
    return opens + (closes - opens) * (np.arange(count) + 0.5) / count

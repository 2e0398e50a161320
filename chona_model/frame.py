"""One frame of a shot: its actors' pictures, scene-linear and layered by depth."""

from __future__ import annotations

import numpy as np

from chona_model.actor import EMPTY_DEPTH, Actor, Picture
from chona_model.camera import Camera
from chona_model.formats.exr import FrameLayers
from chona_model.formats.shot import Shot
from chona_model.passes import ALL_PASSES, Passes
from chona_model.settings import RenderSettings

Matte = np.ndarray | None
Layer = tuple[np.ndarray, np.ndarray, Matte, Matte, Matte]
"""Combined, depth, human, object and confidence; None for a pass that is not wanted."""


class ShotRenderer:
    """Renders frames of one shot.

    Where a shot has several actors, the last picture of each is kept: while neither the actor nor the camera moves it
    is not rendered again.

    Attributes:
        kept: pictures of actors that were taken from the frame before.
    """

    def __init__(self, actor: Actor, shot: Shot, settings: RenderSettings, passes: Passes = ALL_PASSES) -> None:
        self.actor, self.shot, self.settings, self.passes = actor, shot, settings, passes
        self.kept = 0
        self._last: dict[int, tuple[bytes, Picture]] = {}

    def render(self, index: int, camera: Camera | None = None) -> FrameLayers:
        """The pixels of the frame at ``index``, seen by the shot's camera or another."""
        camera = camera or self.shot.camera(index)
        near, far = self.shot.clip[index]
        merged: Layer | None = None
        for number in range(len(self.shot.actors)):
            layer = _layer(self._picture(number, index, camera), near, far, self.passes)
            merged = layer if merged is None else _merge(merged, layer)
        assert merged is not None  # a shot has an actor
        combined, depth, human, thing, confidence = merged
        scaled = None
        if self.passes.depth:
            scale = np.float32(self.shot.world_scale)
            scaled = np.where(depth < EMPTY_DEPTH, depth * scale, np.float32(EMPTY_DEPTH))
        return FrameLayers(combined, scaled, human, thing, confidence)

    def _picture(self, number: int, index: int, camera: Camera) -> Picture:
        pose = self.shot.actors[number].pose(index)
        if len(self.shot.actors) == 1:
            return self.actor.render(pose, camera, self.settings)
        arrays = (pose.world_from_bone, pose.world_from_object, camera.world_from_camera, camera.intrinsics)
        key = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
        if number in self._last and self._last[number][0] == key:
            self.kept += 1
        else:
            self._last[number] = key, self.actor.render(pose, camera, self.settings)
        return self._last[number][1]


def render_frame(
    actor: Actor, shot: Shot, index: int, settings: RenderSettings, camera: Camera | None = None,
    passes: Passes = ALL_PASSES,
) -> FrameLayers:  # fmt: skip
    """One frame's pixels, seen by the shot's camera or another: actors are layered by depth, pixel by pixel."""
    return ShotRenderer(actor, shot, settings, passes).render(index, camera)


def _layer(picture: Picture, near: float, far: float, passes: Passes) -> Layer:
    """Scene-linear, premultiplied; empty where the surface lies outside the clip range, as Blender's camera cuts."""
    kept = (picture.depth >= near) & (picture.depth <= far)
    # Powers are dear: only pixels that show anything are made linear.
    shown = np.flatnonzero(kept & (picture.alpha > 0))
    alpha = picture.alpha.reshape(-1, 1)[shown]
    straight = np.clip(picture.rgb.reshape(-1, 3)[shown] / alpha, 0.0, 1.0)
    combined = np.zeros((*picture.alpha.shape, 4), dtype=np.float32)
    combined.reshape(-1, 4)[shown] = np.concatenate([linear_from_srgb(straight) * alpha, alpha], axis=-1)
    return (
        combined, np.where(kept, picture.depth, np.float32(EMPTY_DEPTH)),
        picture.human * kept if passes.mattes else None, picture.object * kept if passes.mattes else None,
        picture.confidence if passes.confidence else None,
    )  # fmt: skip


def _merge(one: Layer, other: Layer) -> Layer:
    """Two layers, the nearer over the farther in every pixel."""
    nearer = one[1] <= other[1]

    def parted(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        first = nearer if a.ndim == 2 else nearer[..., None]
        return np.where(first, a, b), np.where(first, b, a)

    front, back = parted(one[0], other[0])
    through = 1.0 - front[..., 3]

    def matte(a: Matte, b: Matte) -> Matte:
        if a is None or b is None:
            return None
        before, behind = parted(a, b)
        return before + through * behind

    confidence = None if one[4] is None or other[4] is None else np.minimum(one[4], other[4])
    return (
        front + through[..., None] * back, np.minimum(one[1], other[1]), matte(one[2], other[2]),
        matte(one[3], other[3]), confidence,
    )  # fmt: skip


def linear_from_srgb(colour: np.ndarray) -> np.ndarray:
    """The sRGB transfer curve (IEC 61966-2-1) undone; 0…1 to 0…1, float32."""
    low, high = colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4
    return np.where(colour <= 0.04045, low, high).astype(np.float32)

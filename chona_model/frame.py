"""One frame of a shot: its actors in one picture, scene-linear."""

from __future__ import annotations

import numpy as np

from chona_model.actor import EMPTY_DEPTH, Actor, Picture
from chona_model.camera import Camera
from chona_model.formats.exr import FrameLayers
from chona_model.formats.shot import Shot
from chona_model.passes import ALL_PASSES, Passes
from chona_model.samples import beside_each_other, composite, over_each_other
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
        combined, depth, human, thing, confidence = _layer(self._together(index, camera), near, far, self.passes)
        scaled = None
        if self.passes.depth:
            scale = np.float32(self.shot.world_scale)
            scaled = np.where(depth < EMPTY_DEPTH, depth * scale, np.float32(EMPTY_DEPTH))
        return FrameLayers(combined, scaled, human, thing, confidence)

    def _together(self, index: int, camera: Camera) -> Picture:
        """All actors in one picture: where several show, their samples are sorted along the rays."""
        pictures = [self._picture(number, index, camera) for number in range(len(self.shot.actors))]
        picture = beside_each_other(pictures)
        both = over_each_other(pictures)
        if not both.any():
            return picture
        samples = [self.actor.sample(member.pose(index), camera, self.settings, both) for member in self.shot.actors]
        return composite(samples, camera, self.settings.supersampling, picture, both)

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
    """One frame's pixels, seen by the shot's camera or another; several actors are merged sample by sample."""
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


def linear_from_srgb(colour: np.ndarray) -> np.ndarray:
    """The sRGB transfer curve (IEC 61966-2-1) undone; 0…1 to 0…1, float32."""
    low, high = colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4
    return np.where(colour <= 0.04045, low, high).astype(np.float32)

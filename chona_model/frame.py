"""One frame of a shot: its actors in one picture, scene-linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from chona_model.actor import EMPTY_DEPTH, Actor, Picture
from chona_model.adaptive import Reached, render_within, together
from chona_model.camera import Camera
from chona_model.data.dataset import Pose
from chona_model.formats.exr import FrameLayers
from chona_model.formats.shot import Shot
from chona_model.passes import DEFAULT_PASSES, Passes
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

    Args:
        actors: what renders each of the shot's actors.
        max_error: bound on every pixel's colour and alpha, see ``adaptive.render_within``; 0 for none.
    """

    def __init__(
        self, actors: Sequence[Actor], shot: Shot, settings: RenderSettings, passes: Passes = DEFAULT_PASSES,
        max_error: float = 0.0,
    ) -> None:  # fmt: skip
        self.actors, self.shot, self.settings, self.passes, self.max_error = actors, shot, settings, passes, max_error
        self.kept = 0
        self._last: dict[tuple[int, RenderSettings], tuple[bytes, Picture]] = {}
        self._views: list[Reached] = []

    @property
    def reached(self) -> Reached | None:
        """What the bound on the error came to over all frames; None without one, or without frames."""
        return together(self._views)

    def render(self, index: int, camera: Camera | None = None) -> FrameLayers:
        """The pixels of the frame at ``index``, seen by the shot's camera or another."""
        camera = camera or self.shot.camera(index)
        near, far = self.shot.clip[index]
        combined, depth, human, thing, confidence = _layer(self._sharp(index, camera), near, far, self.passes)
        scaled = None
        if self.passes.depth:
            scale = np.float32(self.shot.world_scale)
            scaled = np.where(depth < EMPTY_DEPTH, depth * scale, np.float32(EMPTY_DEPTH))
        return FrameLayers(combined, scaled, human, thing, confidence)

    def _sharp(self, index: int, camera: Camera) -> Picture:
        """The frame's moment through a pinhole, within the bound if there is one."""
        poses = [member.pose(index) for member in self.shot.actors]

        def render(settings: RenderSettings, pixels: np.ndarray | None) -> Picture:
            return self._together(poses, camera, settings, pixels)

        if not self.max_error:
            return render(self.settings, None)
        picture, reached = render_within(render, self.settings, self.max_error)
        self._views.append(reached)
        return picture

    def _together(
        self, poses: Sequence[Pose], camera: Camera, settings: RenderSettings, pixels: np.ndarray | None = None
    ) -> Picture:
        """All actors in one picture: where several show, their samples are sorted along the rays."""
        pictures = [self._picture(number, pose, camera, settings, pixels) for number, pose in enumerate(poses)]
        picture = beside_each_other(pictures)
        both = over_each_other(pictures)
        if not both.any():
            return picture
        parts = [both & (own.alpha > 0) for own in pictures]
        samples = [
            actor.sample(pose, camera, settings, part)
            for actor, pose, part in zip(self.actors, poses, parts, strict=True)
        ]
        picture = replace(picture, rays=picture.rays + sum(int(part.sum()) for part in parts))
        return composite(samples, camera, settings.supersampling, picture, both)

    def _picture(
        self, number: int, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None
    ) -> Picture:
        if len(self.actors) == 1 or pixels is not None:
            return self.actors[number].render(pose, camera, settings, pixels)
        arrays = (pose.world_from_bone, pose.world_from_object, camera.world_from_camera, camera.intrinsics)
        key, place = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays), (number, settings)
        if place in self._last and self._last[place][0] == key:
            self.kept += 1
        else:
            self._last[place] = key, self.actors[number].render(pose, camera, settings)
        return self._last[place][1]


def render_frame(
    actor: Actor, shot: Shot, index: int, settings: RenderSettings, camera: Camera | None = None,
    passes: Passes = DEFAULT_PASSES,
) -> FrameLayers:  # fmt: skip
    """One frame's pixels where all actors are of one model; see ``ShotRenderer``."""
    return ShotRenderer([actor] * len(shot.actors), shot, settings, passes).render(index, camera)


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

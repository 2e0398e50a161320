"""One frame of a shot: its actors in one picture, scene-linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from chona_model.actor import EMPTY_DEPTH, Actor, Picture
from chona_model.adaptive import Reached, render_within, together
from chona_model.blur import SHARP, Blur, Take, blur_of_frame, mean_picture, plan_takes, rays_of_pixel, take_camera
from chona_model.camera import Camera
from chona_model.cryptomatte import collect
from chona_model.data.dataset import Pose
from chona_model.formats.exr import FrameLayers
from chona_model.formats.shot import Shot
from chona_model.grid_actor import GridActor
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.samples import beside_each_other, composite, over_each_other
from chona_model.settings import RenderSettings
from chona_model.upsampling import render_scaled

SAMPLES = 16
"""So many times the memory of a pixel that is looked at, roughly, take its samples that are kept."""

NO_DIRECTION = 1e-6
"""Length of a mean normal at which nothing is left of it but rounding."""


class ShotRenderer:
    """Renders frames of one shot.

    Where a shot has several actors, the last picture of each is kept: while neither the actor nor the camera moves it
    is not rendered again.

    Attributes:
        kept: pictures of actors that were taken from the frame before.

    Args:
        actors: what renders each of the shot's actors.
        max_error: bound on every pixel's colour and alpha, see ``adaptive.render_within``; 0 for none.
        blur: what blurs; frames on which a bound is set are sharp.
        tile: pixels looked at together at most, which bounds memory and changes nothing else; None for the usual.
    """

    def __init__(
        self, actors: Sequence[Actor], shot: Shot, settings: RenderSettings, passes: Passes = DEFAULT_PASSES,
        max_error: float = 0.0, blur: Blur = SHARP, tile: int | None = None,
    ) -> None:  # fmt: skip
        self.blur, self._tile = blur, tile
        for actor in actors:
            if tile is not None and isinstance(actor, GridActor):
                actor.tile = tile
        self.actors, self.shot, self.settings, self.passes, self.max_error = actors, shot, settings, passes, max_error
        self.kept = 0
        self._last: dict[tuple[int, RenderSettings], tuple[bytes, Picture]] = {}
        self._views: list[Reached] = []

    @property
    def reached(self) -> Reached | None:
        """What the bound on the error came to over all frames; None without one, or without frames."""
        return together(self._views)

    def render(self, index: int, camera: Camera | None = None) -> FrameLayers:
        """The pixels of the frame at ``index``, seen by the shot's camera, or sharp by another."""
        blur = SHARP if camera else blur_of_frame(self.shot, index, self.blur)
        if blur.motion or blur.focus:
            picture = self._blurred(index, blur)
        else:
            picture = in_linear(self._sharp(index, camera or self.shot.camera(index)), *self.shot.clip[index])
        return self._layers(picture)

    def _layers(self, picture: Picture) -> FrameLayers:
        """The passes that are wanted of a scene-linear picture."""
        depth = None
        if self.passes.depth:
            scale, shown = np.float32(self.shot.world_scale), picture.depth < EMPTY_DEPTH
            depth = np.where(shown, picture.depth * scale, np.float32(EMPTY_DEPTH))
        return FrameLayers(
            np.concatenate([picture.rgb, picture.alpha[..., None]], axis=-1), depth,
            picture.human if self.passes.mattes else None, picture.object if self.passes.mattes else None,
            picture.confidence if self.passes.confidence else None,
            None if picture.normal is None else unit_normals(picture.normal),
            None if picture.parts is None else collect(matte_names(self.shot), picture.parts),
        )  # fmt: skip

    def _blurred(self, index: int, blur: Blur) -> Picture:
        """The mean of the frame's moments through points of the lens, scene-linear; see ``blur``."""
        shutter, lens = self.shot.shutter if blur.motion else None, self.shot.lens if blur.focus else None
        times = np.zeros(0) if shutter is None else shutter.times
        samples = rays_of_pixel(blur, self.settings.supersampling**2)
        takes = plan_takes(samples, len(times), lens is not None)
        one_ray = replace(self.settings, supersampling=1, resolution=1.0)

        def distance(take: Take) -> float:
            late = 0.0 if take.time is None else abs(times[take.time]) / max(np.ptp(times), 1e-9)
            return late + (0.0 if lens is None else float(np.sqrt(take.lens[0])))

        def render(_: Pose, camera: Camera, __: RenderSettings, pixels: np.ndarray | None) -> Picture:
            def look(take: Take, wanted: np.ndarray) -> Picture:
                poses, own = self.shot.moment(index, take.time)
                own = take_camera(self.shot, index, take, own.resized(camera.width, camera.height), lens is not None)
                return in_linear(self._together(poses, own, one_ray, wanted), *self.shot.clip[index])

            return mean_picture(takes, look, camera, samples, pixels, distance)

        return render_scaled(render, self.shot.actors[0].pose(index), self.shot.camera(index), self.settings, None)

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
        rows = camera.height if self._tile is None else max(self._tile // (SAMPLES * camera.width), 1)
        for top in range(0, camera.height, rows):
            band = np.zeros_like(both)
            band[top : top + rows] = both[top : top + rows]
            if not band.any():
                continue
            parts = [band & (own.alpha > 0) for own in pictures]
            samples = [
                actor.sample(pose, camera, settings, part, self.passes)
                for actor, pose, part in zip(self.actors, poses, parts, strict=True)
            ]
            picture = replace(picture, rays=picture.rays + sum(int(part.sum()) for part in parts))
            picture = composite(samples, camera, settings.supersampling, picture, band)
        return picture

    def _picture(
        self, number: int, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None
    ) -> Picture:
        if len(self.actors) == 1 or pixels is not None:
            return self.actors[number].render(pose, camera, settings, pixels, self.passes)
        arrays = (pose.world_from_bone, pose.world_from_object, camera.world_from_camera, camera.intrinsics)
        key, place = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays), (number, settings)
        if place in self._last and self._last[place][0] == key:
            self.kept += 1
        else:
            self._last[place] = key, self.actors[number].render(pose, camera, settings, None, self.passes)
        return self._last[place][1]


def render_frame(
    actor: Actor, shot: Shot, index: int, settings: RenderSettings, camera: Camera | None = None,
    passes: Passes = DEFAULT_PASSES,
) -> FrameLayers:  # fmt: skip
    """One frame's pixels where all actors are of one model; see ``ShotRenderer``."""
    return ShotRenderer([actor] * len(shot.actors), shot, settings, passes).render(index, camera)


def in_linear(picture: Picture, near: float, far: float) -> Picture:
    """Scene-linear, premultiplied; empty where the surface lies outside the clip range, as Blender's camera cuts."""
    kept = (picture.depth >= near) & (picture.depth <= far)
    # Powers are dear: only pixels that show anything are made linear.
    shown = np.flatnonzero(kept & (picture.alpha > 0))
    alpha = picture.alpha.reshape(-1, 1)[shown]
    straight = np.clip(picture.rgb.reshape(-1, 3)[shown] / alpha, 0.0, 1.0)
    rgb = np.zeros_like(picture.rgb, dtype=np.float32)
    rgb.reshape(-1, 3)[shown] = linear_from_srgb(straight) * alpha
    cut: dict[str, Any] = {
        name: channel * (kept[..., None] if channel.ndim == 3 else kept)
        for name, channel in picture.channels.items()
        if name not in ("rgb", "depth", "confidence")
    }
    return replace(picture, rgb=rgb, depth=np.where(kept, picture.depth, np.float32(EMPTY_DEPTH)), **cut)


def matte_names(shot: Shot) -> tuple[str, ...]:
    """What the parts of a shot's pictures are called in a Cryptomatte: the actor, then its person or object."""
    names = ((member, [*([] if member.person is None else [member.person]), *member.objects]) for member in shot.actors)
    return tuple(f"{member.name}.{name}" for member, own in names for name in own)


def unit_normals(normal: np.ndarray) -> np.ndarray:
    """[H, W, 3] mean normals at length one; zero where they point nowhere."""
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > NO_DIRECTION)


def linear_from_srgb(colour: np.ndarray) -> np.ndarray:
    """The sRGB transfer curve (IEC 61966-2-1) undone; 0…1 to 0…1, float32."""
    low, high = colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4
    return np.where(colour <= 0.04045, low, high).astype(np.float32)

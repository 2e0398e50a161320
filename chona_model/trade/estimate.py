"""``chona estimate``: what baking a shot will take on this computer, from what was measured of the model.

A few of the shot's frames are rendered for two seconds. How they compare with the costs in the model file says how fast
this computer is; how many rays the shot's frames need, which takes milliseconds to count, says the rest.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np

from chona_model.actor import Actor
from chona_model.blur import SHARP, Blur, blur_of_frame, rays_of_pixel
from chona_model.formats.exr import FrameHeader, FrameLayers, write_frame
from chona_model.formats.shot import Shot, ShotActor, ShotError
from chona_model.frame import ShotRenderer
from chona_model.presets import every_preset, find_preset
from chona_model.settings import RenderSettings
from chona_model.trade.cost import Cost, fit_cost

SECONDS = 2.0
"""How long a calibration renders."""

COUNTED = 12
"""Frames of a shot whose rays are counted."""

COMPILED = 5.0
"""A first frame that takes so many seconds more than others had kernels compiled: a bake will find them on the disk."""

LEAVING = 0.2
"""What the end of a process takes of its start: torch's and LLVM's modules are taken down again (0.9 s after 4.3)."""

SMALL = (0.125, 0.25)
"""Sizes at which a preset is timed whose costs the model file does not know."""


@dataclass(frozen=True)
class Estimate:
    """What a preset will take.

    Attributes:
        seconds_per_frame: rendered and written, on average over the shot.
        total_seconds: of the whole bake, its start included.
        psnr, ssim: on views that training did not see; None where nobody measured.
    """

    seconds_per_frame: float
    total_seconds: float
    psnr: float | None
    ssim: float | None


@dataclass(frozen=True)
class ShotEstimate:
    """Estimates by preset.

    Attributes:
        presets: by name; frames: how many the bake has.
        factor: how many times as long this computer takes as the one the model was measured on; None where nobody
            measured.
        start_seconds: until a worker renders frames at its usual pace, and from its last frame to its end.
        write_seconds: of writing a frame.
    """

    presets: dict[str, Estimate]
    frames: int
    factor: float | None
    start_seconds: float
    write_seconds: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def estimate(
    actors: Sequence[Actor], shot: Shot, indices: Sequence[int], trade: Mapping[str, Any] | None, preset: str,
    seconds: float = SECONDS, started: float | None = None, blur: Blur = SHARP,
) -> ShotEstimate:  # fmt: skip
    """Estimates every preset's time for frames ``indices`` of a shot, the program's presets and the user's own.

    Args:
        actors: what renders each of the shot's actors.
        blur: of the bake.
        trade: the model's (``ModelHeader.trade``), or None; also where there are several.
        preset: the calibration renders with; the estimate of it is the best.
        started: seconds that the process has taken until now, waiting included; None takes its processor's.

    Raises:
        SettingsError: an unknown preset.  KeyError: the shot shows what the model does not know.
    """
    started = time.process_time() if started is None else started  # imports and the model
    settings = every_preset() | {preset: find_preset(preset)}
    names = list(settings)
    known = {} if trade is None else trade["presets"]
    chosen = [indices[place] for place in np.linspace(0, len(indices) - 1, min(COUNTED, len(indices))).astype(int)]
    costs = {
        name: Cost(known[name]["fixed_seconds"], known[name]["seconds_per_ray"])
        if name in known
        else _time_small(actors, shot, chosen[len(chosen) // 2], settings[name])
        for name in names
    }
    counted = {name: [_rays(actors, shot, index, settings[name], blur) for index in chosen] for name in names}
    pace = _calibrate(actors, shot, chosen, settings[preset], costs[preset], counted[preset], seconds, blur)
    factor, write, started = pace.factor, pace.write, (started + pace.first) * (1.0 + LEAVING)
    presets = {}
    for name in names:
        frame = factor * fmean(costs[name].seconds(rays) for rays in counted[name]) + write
        presets[name] = Estimate(
            frame, started + frame * len(indices), known.get(name, {}).get("psnr"), known.get(name, {}).get("ssim")
        )
    return ShotEstimate(presets, len(indices), factor if preset in known else None, started, write)


def _rays(actors: Sequence[Actor], shot: Shot, index: int, settings: RenderSettings, blur: Blur) -> int:
    members = zip(actors, shot.actors, strict=True)
    rays = sum(actor.count_rays(member.pose(index), shot.camera(index), settings) for actor, member in members)
    of_pixel = settings.supersampling**2
    return rays * rays_of_pixel(blur_of_frame(shot, index, blur), of_pixel) // of_pixel


def _forget_poses(actors: Sequence[Actor]) -> None:
    for actor in actors:
        actor.forget_poses()


@dataclass(frozen=True)
class _Pace:
    """How many times as long as its cost says a frame takes here.

    Attributes:
        write: seconds of writing a frame; first: seconds more that the first frame takes, which loads kernels.
    """

    factor: float
    write: float
    first: float


def _calibrate(
    actors: Sequence[Actor], shot: Shot, chosen: Sequence[int], settings: RenderSettings, cost: Cost,
    rays: Sequence[int], seconds: float, blur: Blur,
) -> _Pace:  # fmt: skip
    def render(place: int) -> tuple[FrameLayers, float]:
        _forget_poses(actors)
        start = time.perf_counter()
        layers = ShotRenderer(actors, shot, settings, blur=blur).render(chosen[place])
        return layers, time.perf_counter() - start

    # Any beginning of this order is spread over the shot (bits reversed), as few frames may fit the time.
    order = sorted(range(len(chosen)), key=lambda place: f"{place:08b}"[::-1])
    layers, first = render(order[0])  # loads kernels
    taken = expected = 0.0
    began, turn = time.perf_counter(), 0
    while turn == 0 or time.perf_counter() - began < seconds:
        place = order[turn % len(order)]
        taken += render(place)[1]
        expected += max(cost.seconds(rays[place]), 1e-6)
        turn += 1
    factor = taken / expected  # of sums, as a bake's time is one: a median would leave out what disturbs a few frames
    with tempfile.TemporaryDirectory(prefix="chona-") as folder:
        times = []
        for number in range(3):
            start = time.perf_counter()
            write_frame(Path(folder) / f"{number}.exr", layers, FrameHeader("", "", "", "{}", 0.0, 0))
            times.append(time.perf_counter() - start)
    more = max(first - factor * cost.seconds(rays[order[0]]), 0.0)
    return _Pace(factor, median(times), more if more < COMPILED else 0.0)


def _time_small(actors: Sequence[Actor], shot: Shot, index: int, settings: RenderSettings) -> Cost:
    """Costs of a preset nobody measured, from small pictures of one frame."""
    rays, seconds = [], []
    for scale in (SMALL[0], *SMALL):  # the first loads kernels and does not count
        camera = shot.camera(index).scaled(scale)
        _forget_poses(actors)
        start = time.perf_counter()
        members = zip(actors, shot.actors, strict=True)
        pictures = [actor.render(member.pose(index), camera, settings) for actor, member in members]
        seconds.append(time.perf_counter() - start)
        rays.append(sum(picture.rays for picture in pictures) * settings.supersampling**2)
    return fit_cost(rays[1:], seconds[1:])


def reference_shot(trade: Mapping[str, Any], bones: Sequence[str]) -> Shot:
    """The view that a model's trade was measured on first, for calibrations without a shot.

    Args:
        bones: names of the model's.

    Raises:
        ShotError: the view is none; the model file was changed by another program.
    """
    view = trade["reference"]
    try:
        matrices = np.array(view["world_from_bone"] or np.zeros((0, 4, 4)), dtype=np.float64)
        things = np.array(view["world_from_object"], dtype=np.float64).reshape(-1, 4, 4)
    except ValueError as error:
        raise ShotError(f"the view that the model was measured on is damaged ({error}); measure it again") from error
    actor = ShotActor(
        "reference", view["person"], tuple(view["objects"]), tuple(bones) if view["person"] else (), matrices[None],
        things[None],
    )  # fmt: skip
    return Shot(
        "reference", 24.0, view["width"], view["height"], view["kind"], np.zeros(1, np.int64),
        np.array(view["intrinsics"])[None], np.array(view["world_from_camera"])[None], np.array([[0.0, 1e6]]), (actor,),
    )  # fmt: skip

"""Settings measured side by side on the same views: time, memory, quality, and distance from the exact settings."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median
from typing import Any

import numpy as np

from chona_model.actor import Actor, Picture
from chona_model.data.dataset import View
from chona_model.data.images import load_pixels
from chona_model.evaluate.metrics import mean_of_known, psnr, ssim
from chona_model.settings import RENDER_PRESETS, RenderSettings
from chona_model.trade.cost import Cost, fit_cost
from chona_model.trade.memory import PeakMemory

SOLID = 0.5
"""Depth is compared where both pictures are at least this opaque."""

Perceptual = Callable[[np.ndarray, np.ndarray], float]


@dataclass(frozen=True)
class Sample:
    """One setting on one view.

    Attributes:
        seconds: of a frame with a new pose at the measured size; rays: that were traced; full_rays: of the full size.
        megabytes: peak of the process while it rendered, or None.
        psnr, ssim, lpips: against the picture; lpips is None where it is not installed.
        error: root mean square of colour against ``exact`` over pixels that either shows, 0…1.
        error_alpha: mean of alpha over the same; error_depth: mean over pixels solid in both, metres, or None.
        failed_share: of samples without a root; failed: pixels with any.
    """

    seconds: float
    rays: int
    full_rays: int
    megabytes: float | None
    psnr: float
    ssim: float
    lpips: float | None
    error: float
    error_alpha: float
    error_depth: float | None
    failed_share: float
    failed: int


class Bench:
    """Measures settings on views; what was rendered exactly is kept.

    Args:
        actor: the model; views: that training did not see; scale: share of their size that is measured.
        device: for peak memory; perceptual: LPIPS of two images, or None.
    """

    def __init__(
        self, actor: Actor, views: Sequence[View], scale: float, device: str = "cpu",
        perceptual: Perceptual | None = None,
    ) -> None:  # fmt: skip
        self.actor, self.views, self.scale, self.device = actor, list(views), scale, device
        self.perceptual = perceptual
        self._exact: dict[int, tuple[Picture, float, float | None]] = {}
        self._targets: dict[int, np.ndarray] = {}

    def sample(self, number: int, settings: RenderSettings) -> Sample:
        """One setting on one view."""
        view = self.views[number]
        exact = self._exact_picture(number)
        if settings == RENDER_PRESETS["exact"]:
            picture, seconds, megabytes = exact
        else:
            picture, seconds, megabytes = self._render(number, settings)
        if number not in self._targets:
            self._targets[number] = load_pixels(view, self.scale).rgb
        target, prediction = self._targets[number], np.clip(picture.rgb, 0.0, 1.0)
        side = settings.supersampling**2
        return Sample(
            seconds, picture.rays * side, self.actor.count_rays(view.pose, view.camera, settings), megabytes,
            psnr(prediction, target), ssim(prediction, target),
            self.perceptual(prediction, target) if self.perceptual else None, *differences(picture, exact[0]),
            picture.failed_share, int((picture.confidence < 1.0).sum()),
        )  # fmt: skip

    def seconds(self, number: int, settings: RenderSettings, scale: float) -> tuple[int, float]:
        """Rays and seconds of a view at another size; nothing else is measured."""
        view = self.views[number]
        camera = view.camera.scaled(scale)
        self.actor.forget_poses()
        began = time.perf_counter()
        picture = self.actor.render(view.pose, camera, settings)
        return picture.rays * settings.supersampling**2, time.perf_counter() - began

    def _render(self, number: int, settings: RenderSettings) -> tuple[Picture, float, float | None]:
        view = self.views[number]
        camera, peak = view.camera.scaled(self.scale), PeakMemory(self.device)
        self.actor.forget_poses()
        began = time.perf_counter()
        picture = self.actor.render(view.pose, camera, settings)
        return picture, time.perf_counter() - began, peak.megabytes()

    def _exact_picture(self, number: int) -> tuple[Picture, float, float | None]:
        if number not in self._exact:
            self._exact[number] = self._render(number, RENDER_PRESETS["exact"])
        return self._exact[number]


def differences(picture: Picture, exact: Picture) -> tuple[float, float, float | None]:
    """Colour (root mean square), alpha (mean) and depth (mean, metres; None where nothing is solid in both)."""
    shown = (picture.alpha > 0) | (exact.alpha > 0)
    solid = (picture.alpha > SOLID) & (exact.alpha > SOLID)
    if not shown.any():
        return 0.0, 0.0, None
    colour = np.clip(picture.rgb[shown], 0, 1).astype(np.float64) - np.clip(exact.rgb[shown], 0, 1)
    alpha = np.abs(picture.alpha[shown].astype(np.float64) - exact.alpha[shown])
    depth = np.abs(picture.depth[solid].astype(np.float64) - exact.depth[solid])
    return float(np.sqrt((colour**2).mean())), float(alpha.mean()), float(depth.mean()) if solid.any() else None


@dataclass(frozen=True)
class Measured:
    """A setting over all views; fields as ``Sample``'s, medians of seconds and peaks, means of the rest.

    Attributes:
        full_seconds: of a frame at the views' full size, by ``cost``.
        views: it was measured on.
    """

    settings: RenderSettings
    seconds: float
    full_seconds: float
    cost: Cost
    megabytes: float | None
    psnr: float
    ssim: float
    lpips: float | None
    error: float
    error_alpha: float
    error_depth: float | None
    failed_share: float
    failed: float
    rays: float
    views: int

    def as_dict(self) -> dict[str, Any]:
        """For ``trade.json``: ``seconds`` are of the views' full size."""
        names = ("psnr", "ssim", "lpips", "error", "error_alpha", "error_depth", "failed_share", "failed", "views")
        return {
            "seconds": self.full_seconds, "measured_seconds": self.seconds, "fixed_seconds": self.cost.fixed,
            "seconds_per_ray": self.cost.per_ray, "rays": self.rays, "megabytes": self.megabytes,
            **{name: getattr(self, name) for name in names},
        }  # fmt: skip


def combine(settings: RenderSettings, samples: Sequence[Sample], more: Sequence[tuple[int, float]] = ()) -> Measured:
    """What samples of one setting come to.

    Args:
        more: further (rays, seconds) at other sizes, for the cost.
    """
    cost = fit_cost(
        [sample.rays for sample in samples] + [rays for rays, _ in more],
        [sample.seconds for sample in samples] + [seconds for _, seconds in more],
    )
    seconds, rays = median(sample.seconds for sample in samples), fmean(sample.full_rays for sample in samples)
    same_size = all(sample.rays >= sample.full_rays for sample in samples)
    averaged = {
        name: mean_of_known([getattr(sample, name) for sample in samples])
        for name in ("psnr", "ssim", "lpips", "error", "error_alpha", "error_depth", "failed_share", "failed")
    }
    peaks = [sample.megabytes for sample in samples if sample.megabytes is not None]
    return Measured(
        settings=settings, seconds=seconds, full_seconds=seconds if same_size else cost.seconds(rays), cost=cost,
        megabytes=max(peaks) if peaks else None, rays=rays, views=len(samples), **averaged,  # type: ignore[arg-type]
    )  # fmt: skip


def measure_all(
    bench: Bench, settings: Mapping[str, RenderSettings], numbers: Sequence[int], go_on: Callable[[int], bool],
    costed: Sequence[str] = (), tick: Callable[[int], None] = lambda _: None,
) -> dict[str, Measured]:  # fmt: skip
    """Several settings in turn on each view, so that a loud neighbour disturbs all alike.

    Args:
        settings: by name; numbers: of the views; costed: names that are also timed at half the size.
        go_on: asked before every view but the first; tick: called before every picture; both get the views done.
    """
    samples: dict[str, list[Sample]] = {name: [] for name in settings}
    more: dict[str, list[tuple[int, float]]] = {name: [] for name in settings}
    for done, number in enumerate(numbers):
        if done and not go_on(done):
            break
        for name, each in settings.items():
            tick(done)
            samples[name].append(bench.sample(number, each))
            if name in costed:
                more[name].append(bench.seconds(number, each, bench.scale / 2))
    return {name: combine(each, samples[name], more[name]) for name, each in settings.items()}

"""Views with an error bound: pixels on which two settings disagree are rendered again with finer ones.

The settings climb a ladder. Two rungs are rendered whole; after that only pixels that moved by more than the bound
between the last two rungs, and their neighbours, are rendered on the next one. What is left on the top rung is counted.
The bound is an estimate of the error, from the distance between two rungs, not a proof.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy import ndimage

from chona_model.actor import Picture, merge
from chona_model.settings import ExactSettings, RenderSettings

Render = Callable[[RenderSettings, np.ndarray | None], Picture]
"""Renders one view with the given settings, or some pixels [H, W] bool of it."""

RUNGS = 4
"""Settings on a ladder, the first being those asked for."""

FINEST_STEP, MOST_RAYS, MOST_SAMPLES, MOST_STARTS = 1e-3, 8, 512, 10
"""Where a ladder ends: metres between samples, rays a pixel along each axis, samples a ray, starts a sample."""


@dataclass(frozen=True)
class Reached:
    """What a bound came to.

    Attributes:
        asked: the bound on colour (sRGB, premultiplied) and alpha.
        error: largest change of any pixel between its last two rungs; settled pixels lie within ``asked``.
        unsettled: pixels still above ``asked`` on the top rung.
        pixels: that show anything on any rung; refined: that were rendered on more than two.
        rungs: rendered, at least in part; rays: traced in all.
    """

    asked: float
    error: float
    unsettled: int
    pixels: int
    refined: int
    rungs: int
    rays: int

    def as_dict(self) -> dict[str, float]:
        """For JSON."""
        return asdict(self)

    def sentence(self) -> str:
        """In words."""
        share = self.refined / max(self.pixels, 1)
        if self.unsettled == 0:
            return f"every pixel within {self.asked:g} ({self.error:.3g}), {share:.0%} refined"
        return (
            f"{self.unsettled} of {self.pixels} pixels above {self.asked:g} (up to {self.error:.3g}) with the finest "
            f"settings, {share:.0%} refined"
        )


def together(views: Sequence[Reached]) -> Reached | None:
    """What a bound came to over several views; None for none."""
    if not views:
        return None
    sums = {name: sum(getattr(each, name) for each in views) for name in ("unsettled", "pixels", "refined", "rays")}
    error, rungs = max(each.error for each in views), max(each.rungs for each in views)
    return Reached(asked=views[0].asked, error=error, rungs=rungs, **sums)


def ladder(settings: RenderSettings) -> list[RenderSettings]:
    """Settings of rising accuracy and cost; everything left out below is put in on the second rung."""
    rungs = [replace(settings, resolution=1.0)]
    while len(rungs) < RUNGS:
        last = rungs[-1]
        rungs.append(
            replace(
                last, step=max(last.step / 2, FINEST_STEP), stop=last.stop / 10, starts=2, offset=True, shading=True,
                newton_steps=last.newton_steps + 4, supersampling=min(2 * last.supersampling, MOST_RAYS),
                occupancy_cell=1, occupancy_threshold=0.0, exact=_finer(last.exact),
            )
        )  # fmt: skip
    return rungs


def _finer(exact: ExactSettings) -> ExactSettings:
    inverse = replace(
        exact.inverse, starts=min(exact.inverse.starts + 2, max(exact.inverse.starts, MOST_STARTS)),
        steps=2 * exact.inverse.steps if exact.inverse.steps < 40 else exact.inverse.steps,
        tolerance=min(exact.inverse.tolerance, 1e-5),
    )  # fmt: skip
    return replace(
        exact, samples=min(2 * exact.samples, MOST_SAMPLES), inverse=inverse, covariance="warped", offset=True,
        shading=True, roots="network", field_precision="own",
    )  # fmt: skip


def render_within(render: Render, settings: RenderSettings, bound: float) -> tuple[Picture, Reached]:
    """Renders a view until no pixel's colour or alpha changes by more than ``bound`` from one rung to the next.

    Args:
        render: one view, of one actor or of several in one picture.
        settings: the first rung; of its resolution only full size is used.
        bound: 0…1, as colours are; what the last two rungs of a pixel may differ by.
    """
    rungs = ladder(settings)
    last, picture = (render(rung, None) for rung in rungs[:2])
    rays = sum(part.rays * rung.supersampling**2 for part, rung in zip((last, picture), rungs[:2], strict=True))
    change = _apart(last, picture)
    shown = (last.alpha > 0) | (picture.alpha > 0)
    refined = np.zeros_like(shown)
    used = 2
    for rung in rungs[2:]:
        above = change > bound
        if not above.any():
            break
        # A pixel beside one that moved may have stayed by chance.
        wanted = ndimage.binary_dilation(above, np.ones((3, 3), bool)) & shown
        finer = render(rung, wanted)
        rays += finer.rays * rung.supersampling**2
        change = np.where(wanted, _apart(picture, finer), change)
        # A picture's count is of pixels; these were counted already.
        picture = replace(merge(picture, finer, wanted), rays=picture.rays)
        refined |= wanted
        used += 1
    reached = Reached(
        bound, float(change.max(initial=0.0)), int((change > bound).sum()), int(shown.sum()), int(refined.sum()), used,
        int(rays),
    )  # fmt: skip
    return picture, reached


def _apart(one: Picture, other: Picture) -> np.ndarray:
    """[H, W] largest difference of colour and alpha."""
    return np.maximum(np.abs(one.rgb - other.rgb).max(axis=-1), np.abs(one.alpha - other.alpha))

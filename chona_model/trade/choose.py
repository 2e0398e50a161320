"""The front between speed and accuracy, and the best settings under a budget or above a floor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from chona_model.settings import RenderSettings, SettingsError
from chona_model.trade.knobs import Knob
from chona_model.trade.measure import Measured

WORTH = 0.97
"""A change that leaves more than this share of the time is no saving."""


Loss = Callable[[Measured], float]


def error(measured: Measured) -> float:
    """Distance from ``exact``."""
    return measured.error


def front(measured: Iterable[Measured], loss: Loss = error) -> list[Measured]:
    """Those that no other beats in both time and ``loss``, from fast to slow."""
    best: list[Measured] = []
    for each in sorted(measured, key=lambda m: (m.full_seconds, loss(m))):
        if not best or loss(each) < loss(best[-1]):
            best.append(each)
    return best


def choose(measured: Sequence[Measured], seconds: float | None, psnr: float | None) -> Measured:
    """The most accurate settings within a time, or the fastest above a quality; within both, the most accurate.

    Args:
        seconds: most a frame may take, at the views' full size; psnr: least dB on the views.

    Raises:
        SettingsError: none are; the message says which come nearest.
    """
    quick = [each for each in measured if seconds is None or each.full_seconds <= seconds]
    if not quick:
        fastest = min(measured, key=lambda each: each.full_seconds)
        raise SettingsError(
            f"no settings render a frame in {seconds:g} s: the fastest measured take {fastest.full_seconds:.3g} s "
            f"({fastest.psnr:.2f} dB); allow that much, or smaller frames"
        )
    good = [each for each in quick if psnr is None or each.psnr >= psnr]
    if not good:
        nearest = max(quick, key=lambda each: each.psnr)
        within = "" if seconds is None else f" within {seconds:g} s"
        raise SettingsError(
            f"no settings reach {psnr:g} dB{within}: the best measured have {nearest.psnr:.2f} dB "
            f"({nearest.full_seconds:.3g} s); ask for that, or train longer"
        )
    if seconds is None:
        return min(good, key=lambda each: each.full_seconds)
    return min(good, key=lambda each: each.error)


def descend(
    base: Measured, knobs: Sequence[tuple[Knob, Measured]], measure: Callable[[RenderSettings], Measured | None]
) -> list[Measured]:
    """Settings that combine knobs, ever faster: each takes the knob that adds least error for the time it saves.

    Errors of knobs alone are taken to add up as squares and their shares of the time to multiply; what comes of it is
    measured, and the next step starts from there.

    Args:
        base: where the knobs were turned from; knobs: each alone, as measured.
        measure: measures combined settings; None ends the search.
    """
    current, left = base, list(knobs)
    steps: list[Measured] = []
    floor = base.error**2
    while True:
        candidates = []
        for knob, alone in left:
            share = alone.full_seconds / base.full_seconds
            changed = knob.applied(current.settings)
            if share < WORTH and changed != current.settings:
                candidates.append(((max(alone.error**2 - floor, 0.0) + 1e-12) / (1.0 - share), knob, changed))
        if not candidates:
            return steps
        _, knob, changed = min(candidates, key=lambda candidate: candidate[0])
        left = [pair for pair in left if pair[0] != knob]
        measured = measure(changed)
        if measured is None:
            return steps
        steps.append(measured)
        if measured.full_seconds < current.full_seconds:
            current = measured

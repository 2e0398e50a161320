"""What can go wrong while training, in words, and errors of pictures in decibels."""

from __future__ import annotations

import math

NO_ERROR = 1e-10
"""Mean squared errors below this count as this: 100 dB."""


class TrainingError(RuntimeError):
    """Training that cannot go on: the message says at which step, why, and what to do."""


class NotSavedError(OSError):
    """A training whose files could not be written: why, what to do, and what there is to go on from."""


def decibels(error: float) -> float:
    """PSNR of a mean squared error of values in 0…1, dB; NaN stays NaN."""
    return -10.0 * math.log10(max(error, NO_ERROR)) if math.isfinite(error) else math.nan


def likely_causes(rates: str) -> str:
    """What to look at when a training is lost; ``rates``: the trainer's, in words."""
    return (
        f"likely causes are rates that are too high ({rates}), or poses and masks that do not fit the images (see "
        "'chona check-data')"
    )


def loss_not_finite(step: int, loss: float, rates: str) -> str:
    """Of a step, from 0, whose loss is NaN or infinite."""
    return f"the loss of step {step} is {loss}; {likely_causes(rates)}"


def density_not_finite(name: str, rates: str) -> str:
    """Of a person or object whose density is NaN or infinite somewhere."""
    return f"the density of '{name}' is not finite; {likely_causes(rates)}"

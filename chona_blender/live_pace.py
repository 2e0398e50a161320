"""How finely the live preview renders a pose: coarse while it moves, finer when it rests, never for too long."""

from __future__ import annotations

from dataclasses import dataclass

from .camera import ImageFormat

DRAFT_WIDTH = 256


@dataclass(frozen=True)
class Stage:
    """How a pose is rendered: once it has rested for ``idle`` seconds, at ``share`` of the view's camera frame, but not
    larger than takes ``longest`` seconds.

    A picture that is being rendered cannot be called back, and for so long a new pose would have to wait.
    """

    preset: str
    idle: float
    share: float
    longest: float


STAGES = (Stage("draft", 0.0, 0.0, 0.2), Stage("preview", 0.3, 0.5, 0.5), Stage("final", 0.8, 1.0, 2.0))
"""The first while something moves, the others once each when it has come to rest."""

DEARER = 4.0
"""How many times the seconds a pixel of the stage before, until a stage's own are known."""


class Pace:
    """What is known of how fast the worker is."""

    def __init__(self) -> None:
        self._rates: dict[int, float] = {}

    def learn(self, stage: int, seconds: float, pixels: int) -> None:
        """A stage took so long for so many pixels."""
        self._rates[stage] = seconds / max(pixels, 1)

    def scale(self, stage: int, image: ImageFormat, frame_width: float) -> float:
        """Share of an image's resolution to render a stage at, more than 0 and at most 1.

        Args:
            frame_width: of the camera's whole frame in the view, pixels.
        """
        coarsest = min(1.0, DRAFT_WIDTH / image.width)
        if stage == 0:
            return coarsest
        scale = max(coarsest, min(1.0, STAGES[stage].share * frame_width / image.full_width))
        rate = self._rates.get(stage, DEARER * self._rates.get(stage - 1, 0.0))
        seconds = rate * image.width * image.height * scale**2
        return max(coarsest, scale * min(1.0, (STAGES[stage].longest / seconds) ** 0.5)) if seconds > 0.0 else scale

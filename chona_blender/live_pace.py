"""How finely the live preview renders a pose: coarse while it moves, finer when it rests, never for too long."""

from __future__ import annotations

from dataclasses import dataclass

from .camera import ImageFormat

DRAFT_WIDTH = 256
SMALLEST_WIDTH = 96
"""Pixels across of a draft, and of one on a computer that is too slow for it."""


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

PATIENCE_SECONDS = (0.5, 2.0)
"""How long a picture may lag behind a figure that moves before it is hidden: at least, and where drafts are slow."""


class Pace:
    """What is known of how fast the worker is."""

    def __init__(self) -> None:
        self._rates: dict[int, float] = {}
        self._draft_seconds = 0.0

    def learn(self, stage: int, seconds: float, pixels: int) -> None:
        """A stage took so long for so many pixels."""
        self._rates[stage] = seconds / max(pixels, 1)
        if stage == 0:
            self._draft_seconds = seconds

    @property
    def patience(self) -> float:
        """Seconds that a picture may lag behind: the time of two drafts, so that slow ones do not flicker."""
        shortest, longest = PATIENCE_SECONDS
        return min(max(shortest, 2.0 * self._draft_seconds), longest)

    def scale(self, stage: int, image: ImageFormat, frame_width: float) -> float:
        """Share of an image's resolution to render a stage at, more than 0 and at most 1.

        Args:
            frame_width: of the camera's whole frame in the view, pixels.
        """
        draft = min(1.0, DRAFT_WIDTH / image.width)
        least, most = min(1.0, SMALLEST_WIDTH / image.width), draft
        if stage > 0:
            least, most = draft, max(draft, min(1.0, STAGES[stage].share * frame_width / image.full_width))
        rate = self._rates.get(stage, DEARER * self._rates.get(stage - 1, 0.0))
        seconds = rate * image.width * image.height * most**2
        return max(least, most * min(1.0, (STAGES[stage].longest / seconds) ** 0.5)) if seconds > 0.0 else most

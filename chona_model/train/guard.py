"""What keeps a ruined model from being written: numbers that are not finite, and pictures no better than an empty one.

Two questions, both cheap.  Every step tells its error and the error of an empty picture on the same rays; where the
first stays near the second or above it, the model shows nothing, or fog.  And every so often, and before anything is
written, all tensors are looked through for NaN and infinity: a table row that no ray of this step has read can hold one
while the loss is fine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from chona_model.train.errors import TrainingError, likely_causes

FOG = 1.05
"""From this share of an empty picture's error on the model does not just show nothing."""


@dataclass(frozen=True)
class GuardSettings:
    """When a training counts as lost.

    Attributes:
        window: steps over which errors are averaged (exponentially); glance: those that count as the last few.
        limit: a model whose error is over this share of an empty picture's shows next to nothing.  Trainings that go
            well start at 0.5 to 0.9 and fall (docs/training.md).
        patience: so many steps in a row above the limit, and the training is lost; closing: at its end, so many.
        floor: mean squared errors below this are never held against a model (30 dB): where hardly anything is to be
            seen, an empty picture is nearly right.
        learned: a model once under this share of an empty picture's error had learned something that can be lost.
        look_every: steps between looks at all tensors.
    """

    window: int = 32
    glance: int = 4
    limit: float = 0.95
    patience: int = 150
    closing: int = 32
    floor: float = 1e-3
    learned: float = 0.8
    look_every: int = 100


@dataclass
class GuardState:
    """What a guard remembers; part of a checkpoint.

    Attributes:
        error, empty: averaged squared errors of the model and of an empty picture; last_error, last_empty: the same
            over the last few steps alone.
        above: steps in a row above the limit; seen: steps in all.
        best: lowest share of an empty picture's error; best_step: when.
    """

    error: float = 0.0
    empty: float = 0.0
    last_error: float = 0.0
    last_empty: float = 0.0
    above: int = 0
    seen: int = 0
    best: float = math.inf
    best_step: int = 0


class Guard:
    """Watches one training.

    Args:
        settings: when it is lost; rates: what the trainer was told, in words, for messages; state: from a checkpoint.
    """

    def __init__(self, settings: GuardSettings, rates: str, state: GuardState | None = None) -> None:
        self.settings, self.rates = settings, rates
        self.state = GuardState() if state is None else state

    def observe(self, step: int, report: Mapping[str, float]) -> None:
        """Takes a step's ``loss``, ``psnr`` and ``empty_psnr`` (an empty picture's on the same rays), dB.

        Raises:
            TrainingError: a number that is not finite, or too many steps without anything to be seen.
        """
        settings, state = self.settings, self.state
        if not all(math.isfinite(value) for value in report.values()):
            raise TrainingError(f"step {step} reports {dict(report)}: not finite; {likely_causes(self.rates)}")
        state.seen += 1
        error, empty = (10.0 ** (-report[name] / 10.0) for name in ("psnr", "empty_psnr"))
        # The first steps are averaged evenly: an average that starts at the first value would be ruled by it.
        share, last = 1.0 / min(state.seen, settings.window), 1.0 / min(state.seen, settings.glance)
        state.error += share * (error - state.error)
        state.empty += share * (empty - state.empty)
        state.last_error += last * (error - state.last_error)
        state.last_empty += last * (empty - state.last_empty)
        if self.ratio < state.best and state.seen >= settings.window:
            state.best, state.best_step = self.ratio, step
        state.above = state.above + 1 if self._shows_nothing(state.error, state.empty) else 0
        if state.above >= settings.patience:
            raise TrainingError(self._lost(step))

    @property
    def ratio(self) -> float:
        """The averaged error as a share of an empty picture's."""
        return self.state.error / max(self.state.empty, self.settings.floor)

    @property
    def lost_what_it_had(self) -> bool:
        """Whether the model had learned something and shows next to nothing now: not to be written over a good one."""
        state = self.state
        return state.best < self.settings.learned and self._shows_nothing(state.last_error, state.last_empty)

    def _shows_nothing(self, error: float, empty: float) -> bool:
        floor = self.settings.floor
        return error >= floor and error >= self.settings.limit * max(empty, floor)

    def look_due(self, step: int) -> bool:
        """Whether all tensors are to be looked at after this step."""
        return step % self.settings.look_every == 0

    def look(self, step: int, tensors: Mapping[str, Tensor]) -> None:
        """Looks at all tensors.

        Raises:
            TrainingError: one of them holds NaN or infinity.
        """
        for name, tensor in tensors.items():
            if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
                count = int((~torch.isfinite(tensor)).sum())
                raise TrainingError(
                    f"after step {step} {count} of {tensor.numel()} numbers of '{name}' are not finite; "
                    f"{likely_causes(self.rates)}"
                )

    def close(self, step: int) -> None:
        """The last word before the model is written.

        Raises:
            TrainingError: the model shows next to nothing, because it never learned or because that is gone.
        """
        if self.lost_what_it_had or self.state.above >= self.settings.closing:
            raise TrainingError(self._lost(step))

    def position(self) -> dict[str, float]:
        """What ``GuardState`` is made of again; finite numbers alone, as JSON wants them."""
        return {name: value for name, value in asdict(self.state).items() if math.isfinite(value)}

    def _lost(self, step: int) -> str:
        state = self.state
        ratio = max(self.ratio, state.last_error / max(state.last_empty, self.settings.floor))
        shows = "shows no more than an empty picture" if ratio < FOG else "is worse than an empty picture (fog)"
        since = f"for {state.above} steps up to" if state.above else "at"
        had = f"; it was best at step {state.best_step} ({state.best:.2f})" if state.best < self.settings.limit else ""
        return (
            f"the model {shows} {since} step {step}: its error is {ratio:.2f} of an empty picture's{had}; "
            f"{likely_causes(self.rates)}"
        )

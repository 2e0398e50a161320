"""Which passes of a picture are wanted: what is not asked for is neither computed nor written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

PASSES = ("combined", "depth", "mattes", "confidence", "normal", "cryptomatte")
"""Every pass by name, in the order of a baked frame's layers."""


class PassError(ValueError):
    """A pass that there is none of: the message says what was given and what there is."""


@dataclass(frozen=True)
class Passes:
    """What a baked frame has besides its colours and alpha, which it always has.

    Attributes:
        depth: metres along the camera axis.
        mattes: which share of a pixel is the person, which an object.
        confidence: share of samples whose inverse skinning converged.
        normal: which way surfaces face in the world.
        cryptomatte: mattes of every person and object of every actor, by name.
    """

    depth: bool = True
    mattes: bool = True
    confidence: bool = True
    normal: bool = False
    cryptomatte: bool = False

    @classmethod
    def of(cls, names: Sequence[str]) -> Passes:
        """Of names out of ``PASSES``; ``combined`` may be left out.

        Raises:
            PassError: a name is unknown.
        """
        unknown = [name for name in names if name not in PASSES]
        if unknown:
            raise PassError(f"there is no pass '{unknown[0]}'; expected some of {', '.join(PASSES)}")
        return cls(*(name in names for name in PASSES[1:]))

    @property
    def names(self) -> tuple[str, ...]:
        """The passes that are wanted, in the order of ``PASSES``."""
        return tuple(name for name in PASSES if name == "combined" or getattr(self, name))

    @property
    def left_out(self) -> tuple[str, ...]:
        """The passes that a frame has where nothing else is said, and this one has not."""
        return tuple(name for name in Passes().names if name not in self.names)


DEFAULT_PASSES = Passes()
"""What is wanted where nothing else is said."""

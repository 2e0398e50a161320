"""Which family a set of bone names belongs to, and which bones are which parts of a body.

Rigs and models are recognised alike: a model that was captured from a Mixamo character has Mixamo's names, one that was
trained on SMPL fits has SMPL's.  That is how any of one drives any of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from .families import FAMILIES, Family
from .families.family import REQUIRED, sided


@dataclass(frozen=True)
class Recognition:
    """What was recognised.

    Attributes:
        family: None where not even the usual words were found.
        parts: part → bones, from the root outwards; see ``families.family``.
        missing: required parts without a bone.
    """

    family: Family | None
    parts: dict[str, tuple[str, ...]]
    missing: tuple[str, ...]

    @property
    def label(self) -> str:
        """For people: the family, or that there is none."""
        return self.family.label if self.family is not None else "no known family"

    def part_of(self, bone: str) -> tuple[str, int]:
        """The part that a bone belongs to and its place in the part's chain; ('', 0) for none."""
        for part, chain in self.parts.items():
            if bone in chain:
                return part, chain.index(bone)
        return "", 0


def recognise(names: Sequence[str]) -> Recognition:
    """Finds the family that explains bone names best, and fills its gaps with what left-and-right names give.

    Args:
        names: parents before their children.
    """
    return _recognise(tuple(names))


@lru_cache(maxsize=64)
def _recognise(names: tuple[str, ...]) -> Recognition:
    found = sorted((family.find(names) for family in FAMILIES), key=lambda each: (len(each.missing), -each.score))
    best = found[0]
    if not best.parts or len(best.missing) > len(sided(REQUIRED)) // 2:
        return Recognition(None, {}, tuple(sided(REQUIRED)))
    parts = dict(best.parts)
    used = {bone for chain in parts.values() for bone in chain}
    for part, chain in FAMILIES[-1].find(names).parts.items():
        if part not in parts and not used & set(chain):
            parts[part] = chain
            used.update(chain)
    return Recognition(best.family, parts, tuple(part for part in sided(REQUIRED) if part not in parts))

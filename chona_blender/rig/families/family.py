"""What a rig family is: a table from the parts of a body to the names that the family gives their bones.

A part is a word of the lists below, with ``.L`` or ``.R`` behind it where the body has two.  A table gives each part
one or more *spellings*; a spelling is a chain of names, because a spine, a neck and the halves of a limb are several
bones. ``{side}`` in a name stands for the family's word for left or right.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

MIDDLE = ("hips", "spine", "neck", "head")
"""Parts that a body has once.  ``spine`` and ``neck`` are chains, from below."""

LIMBS = (
    "collar", "upper_arm", "lower_arm", "hand", "knuckles",
    "upper_leg", "lower_leg", "foot", "toe",
)  # fmt: skip
"""Parts that a body has twice.  ``knuckles`` is SMPL's bone of all fingers together."""

FINGERS = tuple(f"{finger}{joint}" for finger in ("thumb", "index", "middle", "ring", "pinky") for joint in (1, 2, 3))

REQUIRED = ("hips", "upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg", "foot", "head", "spine")
"""Without these a rig cannot pose a person."""

_WEIGHTS = dict.fromkeys(REQUIRED, 4.0) | {"collar": 2.0, "neck": 2.0, "toe": 2.0, "knuckles": 1.0}
_FINGER_WEIGHT = 0.1
_EXACT_SHARE = 0.1
"""A name spelled to the letter counts a little more than one that differs in case or separators."""

Spelling = str | tuple[str, ...]


def base(part: str) -> str:
    """A part without its side."""
    return part.removesuffix(".L").removesuffix(".R")


def plain(name: str) -> str:
    """A bone name without namespace, case and separators: ``mixamorig:LeftArm`` and ``left_arm`` are ``leftarm``."""
    return re.sub(r"[\s._\-]+", "", re.split(r"[:|]", name)[-1].lower())


@dataclass(frozen=True)
class Found:
    """What a family's table found among names.

    Attributes:
        family: whose table.
        parts: part → the names of its bones, from the root outwards.
        score: the more parts, the higher.
    """

    family: Family
    parts: dict[str, tuple[str, ...]]
    score: float

    @property
    def missing(self) -> list[str]:
        """Required parts that were not found."""
        return [part for part in sided(REQUIRED) if part not in self.parts]


def sided(parts: Iterable[str]) -> list[str]:
    """Parts with their sides, as they are in tables of results."""
    return [full for part in parts for full in ([part] if part in MIDDLE else [f"{part}.L", f"{part}.R"])]


@dataclass(frozen=True)
class Family:
    """One family's table.

    Attributes:
        name, label: for presets, and for people.
        parts: part without side → spellings, the usual one first.
        sides: words for left and right; several pairs where a family has several.
        prefix: a regular expression of what may stand before every name, in plain form.
        marks: names, in plain form, that no other family has; ``exact_marks``: the same, to the letter.
    """

    name: str
    label: str
    parts: Mapping[str, tuple[Spelling, ...]]
    sides: tuple[tuple[str, str], ...] = (("L", "R"),)
    prefix: str = ""
    marks: tuple[str, ...] = ()
    exact_marks: tuple[str, ...] = ()
    _tables: list[dict[str, list[tuple[str, ...]]]] = field(default_factory=list, repr=False, compare=False)

    def find(self, names: Iterable[str]) -> Found:
        """The parts that the names hold."""
        known: dict[str, str] = {}
        for name in names:
            known.setdefault(re.sub(rf"^(?:{self.prefix})", "", plain(name)) if self.prefix else plain(name), name)
        best = max((self._with(table, known) for table in self._all_tables()), key=lambda found: found.score)
        marked = sum(mark in known for mark in self.marks)
        marked += sum(mark in known.values() for mark in self.exact_marks)
        return Found(self, best.parts, best.score + 2.0 * marked)

    def _all_tables(self) -> list[dict[str, list[tuple[str, ...]]]]:
        """For each pair of side words: part with side → spellings as chains of names."""
        if not self._tables:
            for pair in self.sides:
                table: dict[str, list[tuple[str, ...]]] = {}
                for part, spellings in self.parts.items():
                    chains = [(each,) if isinstance(each, str) else each for each in spellings]
                    if part in MIDDLE:
                        table[part] = chains
                        continue
                    for letter, word in zip("LR", pair, strict=True):
                        table[f"{part}.{letter}"] = [tuple(n.replace("{side}", word) for n in c) for c in chains]
                self._tables.append(table)
        return self._tables

    def _with(self, table: dict[str, list[tuple[str, ...]]], known: dict[str, str]) -> Found:
        parts: dict[str, tuple[str, ...]] = {}
        score = 0.0
        for part, spellings in table.items():
            best_share, best = 0.0, ((), ())
            for chain in spellings:
                here = tuple((known[plain(name)], name) for name in chain if plain(name) in known)
                if len(here) / len(chain) > best_share:
                    best_share, best = len(here) / len(chain), (tuple(pair[0] for pair in here), here)
            if best_share == 0.0:
                continue
            parts[part] = best[0]
            exact = sum(re.split(r"[:|]", name)[-1] == spelled for name, spelled in best[1]) / len(best[1])
            weight = _WEIGHTS.get(base(part), _FINGER_WEIGHT) * (0.5 if part not in MIDDLE else 1.0)
            score += weight * (0.5 + 0.5 * best_share) * (1.0 + _EXACT_SHARE * exact)
        return Found(self, parts, score)


def fingers(pattern: str, names: Mapping[str, str] | None = None) -> dict[str, tuple[Spelling, ...]]:
    """Rows of a table for the fifteen finger bones.

    Args:
        pattern: with ``{finger}`` and ``{joint}``, and ``{side}`` as everywhere.
        names: the family's words for thumb, index, middle, ring and pinky where they differ.
    """
    rows: dict[str, tuple[Spelling, ...]] = {}
    for part in FINGERS:
        finger, joint = part[:-1], part[-1]
        word = (names or {}).get(finger, finger)
        rows[part] = (pattern.replace("{finger}", word).replace("{joint}", joint),)
    return rows

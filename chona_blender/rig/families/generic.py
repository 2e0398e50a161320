"""Rigs of no known family: any name that says left or right and a word for a part of the body.

Helper bones (twist, roll, IK, control, target …) are passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from ..names import name_key
from .family import MIDDLE, Family, Found

_WORDS: dict[str, tuple[str, ...]] = {
    "hips": ("hips", "pelvis", "hip", "root", "cog"),
    "spine": (
        "spine", "abdomen", "abdomenlower", "abdomenupper", "waist", "lowerback", "back", "torso", "ribs", "thorax",
        "chest", "chestlower", "chestupper", "upperchest", "upperbody",
    ),
    "neck": ("neck", "necklower", "neckupper"),
    "head": ("head", "skull"),
    "collar": ("clavicle", "collar", "collarbone", "shoulder"),
    "upper_arm": ("upperarm", "uparm", "arm", "shldr", "shldrbend", "bicep", "humerus", "armstretch"),
    "lower_arm": ("forearm", "lowerarm", "loarm", "lowarm", "forearmbend", "elbow", "radius", "forearmstretch"),
    "hand": ("hand", "wrist"),
    "upper_leg": ("thigh", "upperleg", "upleg", "thighbend", "femur", "hip", "thighstretch"),
    "lower_leg": ("shin", "calf", "lowerleg", "loleg", "lowleg", "knee", "tibia", "leg", "legstretch"),
    "foot": ("foot", "ankle"),
    "toe": ("toe", "toes", "toebase", "ball"),
}  # fmt: skip
_FINGER = re.compile(r"(?:hand|f)?(thumb|index|middle|mid|ring|pinky|little)(?:finger)?0?([123])")
_ONE_NAME = {"mid": "middle", "little": "pinky"}
_HELPERS = re.compile(
    r"twist|roll|pole|target|ctrl|control|tweak|helper|socket|nub|_end\b|(?:^|[ ._-])(?:ik|mch|org|cor|fk)(?:$|[ ._-])",
    re.IGNORECASE,
)
_PART_OF = {(part, word): rank for part, words in _WORDS.items() for rank, word in enumerate(words)}


class Generic(Family):
    """Finds parts by words instead of whole names."""

    def find(self, names: Iterable[str]) -> Found:
        """See ``Family.find``; chains stand in the order of ``names``, which has parents before their children."""
        ranked: dict[str, list[tuple[int, str]]] = {}
        for name in names:
            if _HELPERS.search(name):
                continue
            side, word = name_key(name)
            finger = _FINGER.fullmatch(word)
            if finger and side:
                word = _ONE_NAME.get(finger[1], finger[1])
                ranked.setdefault(f"{word}{finger[2]}.{side}", []).append((0, name))
                continue
            bare = re.sub(r"\d+$", "", word)
            for part in _WORDS:
                if (part in MIDDLE) == (side == "") and (part, bare) in _PART_OF:
                    ranked.setdefault(f"{part}.{side}" if side else part, []).append((_PART_OF[part, bare], name))
                    break
        parts = {part: self._choose(part, found) for part, found in ranked.items()}
        for side in "LR":  # rigs that name bones after their joints: the shoulder is the upper arm
            if f"upper_arm.{side}" not in parts and name_key(*parts.get(f"collar.{side}", ("",)))[1] == "shoulder":
                parts[f"upper_arm.{side}"] = parts.pop(f"collar.{side}")
            legs = sorted(ranked.get(f"lower_leg.{side}", ()))
            if f"upper_leg.{side}" not in parts and len(legs) > 1:  # 'Left leg' above 'Left knee'
                parts[f"upper_leg.{side}"] = (legs[-1][1],)
        return Found(self, parts, 0.5 * len([part for part in parts if part.removesuffix(".L") in _WORDS]))

    @staticmethod
    def _choose(part: str, found: list[tuple[int, str]]) -> tuple[str, ...]:
        if part in ("spine", "neck"):
            return tuple(name for _, name in found)
        return (min(found, key=lambda each: each[0])[1],)


FAMILIES = (Generic("generic", "left and right names", {}),)

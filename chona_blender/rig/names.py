"""Bone names reduced to a side and a word: ``left_hip``, ``L_Hip``, ``hip.L``, ``LeftHip`` are the same."""

from __future__ import annotations

import re

_SIDES = {"l": "L", "left": "L", "r": "R", "right": "R"}
_PREFIXES = {"def", "org", "mixamorig", "bip01", "bip001", "bip", "armature", "cc", "base", "b", "jnt", "bone"}


def name_key(name: str) -> tuple[str, str]:
    """Side ('L', 'R' or '') and word (lower case, no separators) of a bone name."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    words = [word.lower() for word in re.split(r"[\s._:|\-]+", spaced) if word]
    while len(words) > 1 and words[0] in _PREFIXES:
        words = words[1:]
    side = ""
    number = words.pop() if len(words) > 2 and words[-1].isdigit() else ""  # foot.L.001
    for index in (0, -1):
        if len(words) > 1 and words[index] in _SIDES:
            side = _SIDES[words.pop(index)]
            break
    return side, "".join(words) + number

"""Which bone of an armature plays which bone of a model's skeleton, by name.

Names are compared after reducing them to a side and a word: ``left_hip``, ``L_Hip``, ``hip.L``, ``LeftHip`` and
``mixamorig:LeftHip`` are the same.  Rig families whose words differ come in as overrides.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from bpy.types import Object

from ..errors import ChonaError

_SIDES = {"l": "L", "left": "L", "r": "R", "right": "R"}
_PREFIXES = {"def", "org", "mixamorig", "bip01", "bip", "armature"}


def name_key(name: str) -> tuple[str, str]:
    """Side ('L', 'R' or '') and word (lower case, no separators) of a bone name."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    words = [word.lower() for word in re.split(r"[\s._:|\-]+", spaced) if word]
    while len(words) > 1 and words[0] in _PREFIXES:
        words = words[1:]
    side = ""
    for index in (0, -1):
        if len(words) > 1 and words[index] in _SIDES:
            side = _SIDES[words.pop(index)]
            break
    return side, "".join(words)


def bone_mapping(armature: Object, names: Sequence[str], overrides: Mapping[str, str] | None = None) -> dict[str, str]:
    """Finds the armature's bone for every bone of a skeleton.

    Args:
        armature: an armature object.
        names: B bone names of the skeleton.
        overrides: the user's choice, model bone → armature bone; it wins over names.

    Returns:
        model bone → armature bone, in the order of ``names``.

    Raises:
        ChonaError: a bone that maps to nothing or to several, or an override to a bone that does not exist.
    """
    bones = armature.data.bones
    overrides = {key: value for key, value in (overrides or {}).items() if value}
    for name, target in overrides.items():
        if name in names and target not in bones:
            raise ChonaError(
                f"Bone '{name}' of the model is mapped to '{target}', which armature '{armature.name}' does not have. "
                "Choose one of its bones"
            )
    by_key: dict[tuple[str, str], list[str]] = {}
    for bone in bones:
        by_key.setdefault(name_key(bone.name), []).append(bone.name)
    return {name: overrides.get(name) or _find(armature, name, by_key.get(name_key(name), [])) for name in names}


def _find(armature: Object, name: str, candidates: list[str]) -> str:
    bones = armature.data.bones
    if name in bones:
        return name
    if len(candidates) > 1:
        candidates = [each for each in candidates if bones[each].use_deform] or candidates
    if not candidates:
        raise ChonaError(
            f"Bone '{name}' of the model maps to nothing in armature '{armature.name}' ({_listed(bones.keys())}). "
            f"Name a bone '{name}' or choose one for it in the bone mapping"
        )
    if len(candidates) > 1:
        raise ChonaError(
            f"Bone '{name}' of the model could be any of {_listed(candidates)} in armature '{armature.name}'. Choose "
            "one in the bone mapping"
        )
    return candidates[0]


def _listed(names: Iterable[str], most: int = 6) -> str:
    names = list(names)
    shown = ", ".join(f"'{name}'" for name in names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown or "it has no bones"

"""Which bones of an armature play which bone of a model's skeleton.

Both sides are recognised (``recognition``), so any family drives any other: a model's bone takes the armature's bones
of the same part of the body.  The user's choice goes before everything.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bpy.types import Object

from ..errors import ChonaError
from .families.family import MIDDLE, REQUIRED, base
from .names import name_key
from .recognition import Recognition, recognise

FOLLOW = "(parent)"
"""Instead of a bone: the model's bone keeps to its parent."""


@dataclass(frozen=True)
class RigMapping:
    """An armature's bones for a model's.

    Attributes:
        bones: model bone → the armature's bones for it, from the root outwards; several where a limb has segments, none
            where the model's bone follows its parent.
        problems: model bone that must have one but has none → why, for people.
        model, rig: what either side was recognised as.
    """

    bones: dict[str, tuple[str, ...]]
    problems: dict[str, str]
    model: Recognition
    rig: Recognition

    def check(self) -> RigMapping:
        """The mapping itself.

        Raises:
            ChonaError: a bone that must have one maps to nothing, the first of them.
        """
        if self.problems:
            raise ChonaError(next(iter(self.problems.values())))
        return self

    @property
    def summary(self) -> str:
        """One line: the family and how many bones were found."""
        found = sum(bool(bones) for bones in self.bones.values())
        words = f"{self.rig.label}: {found} of {len(self.bones)} bones"
        return f"{words}, {len(self.problems)} missing" if self.problems else words


def map_rig(armature: Object, names: Sequence[str], overrides: Mapping[str, str] | None = None) -> RigMapping:
    """Finds the armature's bones for every bone of a skeleton; what is missing is told, not raised.

    Args:
        names: B bone names of the skeleton, parents first.
        overrides: the user's choice, model bone → armature bone or ``FOLLOW``.

    Raises:
        ChonaError: an override to a bone that does not exist.
    """
    bones = armature.data.bones
    overrides = _checked(armature, names, overrides)
    model, rig = recognise(names), recognise(_rig_names(armature))
    found: dict[str, tuple[str, ...]] = {}
    problems: dict[str, str] = {}
    for index, name in enumerate(names):
        chosen = overrides.get(name, "")
        if chosen:
            found[name] = () if chosen == FOLLOW else _with_segments(chosen, rig)
            continue
        part, place = model.part_of(name)
        if name in bones and rig.part_of(name)[0] in ("", part):
            found[name] = (name,)
        elif part:
            found[name] = _of_part(part, place, len(model.parts[part]), rig)
        else:
            same = [bone.name for bone in bones if name_key(bone.name) == name_key(name)]
            same = [each for each in same if bones[each].use_deform] or same
            found[name] = (same[0],) if len(same) == 1 else ()
        if not found[name] and index == 0 and not part and rig.parts.get("hips"):
            found[name] = rig.parts["hips"]  # a root above the hips
        if not found[name] and _is_needed(part, model):
            problems[name] = _nothing(armature, name)
    return RigMapping(found, problems, model, rig)


def _is_needed(part: str, model: Recognition) -> bool:
    if not part:
        return model.family is None
    return base(part) in REQUIRED


def _rig_names(armature: Object) -> list[str]:
    """Bone names with parents before their children."""
    names: list[str] = []
    pending = [bone for bone in armature.data.bones if bone.parent is None][::-1]
    while pending:
        bone = pending.pop()
        names.append(bone.name)
        pending.extend(reversed(bone.children))
    return names


def _with_segments(bone: str, rig: Recognition) -> tuple[str, ...]:
    """A limb's bone with the segments behind it."""
    part, place = rig.part_of(bone)
    return rig.parts[part][place:] if part and part not in MIDDLE else (bone,)


def _of_part(part: str, place: int, length: int, rig: Recognition) -> tuple[str, ...]:
    """The rig's bones for the bone at ``place`` of a model's part of ``length`` bones."""
    chain = rig.parts.get(part, ())
    if not chain:
        if base(part) == "knuckles":  # of all fingers, the middle one
            side = part[-1]
            return rig.parts.get(f"middle1.{side}") or rig.parts.get(f"index1.{side}") or ()
        return ()
    if length == 1:
        return chain[-1:] if part == "spine" else chain  # one bone for a whole spine must carry the arms
    if part in MIDDLE:
        return (chain[round(place * (len(chain) - 1) / (length - 1))],)
    return (chain[min(place * len(chain) // length, len(chain) - 1)],)


def bone_mapping(armature: Object, names: Sequence[str], overrides: Mapping[str, str] | None = None) -> dict[str, str]:
    """Finds exactly one bone for every bone of a skeleton, by names alone: for a character's own skeleton.

    Args:
        names: B bone names of the skeleton.
        overrides: the user's choice, model bone → armature bone; it wins over names.

    Returns:
        model bone → armature bone, in the order of ``names``.

    Raises:
        ChonaError: a bone that maps to nothing or to several, or an override to a bone that does not exist.
    """
    overrides = _checked(armature, names, overrides)
    by_key: dict[tuple[str, str], list[str]] = {}
    for bone in armature.data.bones:
        by_key.setdefault(name_key(bone.name), []).append(bone.name)
    return {name: overrides.get(name) or _find(armature, name, by_key.get(name_key(name), [])) for name in names}


def _checked(armature: Object, names: Sequence[str], overrides: Mapping[str, str] | None) -> dict[str, str]:
    kept = {key: value for key, value in (overrides or {}).items() if value}
    for name, target in kept.items():
        if name in names and target != FOLLOW and target not in armature.data.bones:
            raise ChonaError(
                f"Bone '{name}' of the model is mapped to '{target}', which armature '{armature.name}' does not have. "
                "Choose one of its bones"
            )
    return kept


def _find(armature: Object, name: str, candidates: list[str]) -> str:
    bones = armature.data.bones
    if name in bones:
        return name
    if len(candidates) > 1:
        candidates = [each for each in candidates if bones[each].use_deform] or candidates
    if not candidates:
        raise ChonaError(_nothing(armature, name))
    if len(candidates) > 1:
        raise ChonaError(
            f"Bone '{name}' of the model could be any of {_listed(candidates)} in armature '{armature.name}'. Choose "
            "one in the bone mapping"
        )
    return candidates[0]


def _nothing(armature: Object, name: str) -> str:
    return (
        f"Bone '{name}' of the model maps to nothing in armature '{armature.name}' "
        f"({_listed(armature.data.bones.keys())}). Choose a bone for it under Rig, Bones, or name one '{name}'"
    )


def _listed(names: Iterable[str], most: int = 6) -> str:
    names = list(names)
    shown = ", ".join(f"'{name}'" for name in names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown or "it has no bones"

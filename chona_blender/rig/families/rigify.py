"""Rigify: the deforming bones of a generated rig, and the metarig it is generated from.

Limbs are split into segments (``DEF-upper_arm.L``, ``DEF-upper_arm.L.001`` …), two by default.  ``DEF-spine`` is the
pelvis; the last three of the chain are neck and head.
"""

from __future__ import annotations

from .family import Family, fingers


def _segments(name: str, prefix: str) -> tuple[str, ...]:
    return (f"{prefix}{name}.{{side}}", f"{prefix}{name}.{{side}}.001")


def _many(name: str) -> tuple[str, ...]:
    return (*_segments(name, "DEF-"), f"DEF-{name}.{{side}}.002", f"DEF-{name}.{{side}}.003")


_THUMB = {"index": "f_index", "middle": "f_middle", "ring": "f_ring", "pinky": "f_pinky"}


def _parts(prefix: str) -> dict:
    spine = f"{prefix}spine"
    limbs = {
        part: (_segments(name, prefix), _many(name), f"{prefix}{name}.{{side}}") if prefix else (f"{name}.{{side}}",)
        for part, name in (
            ("upper_arm", "upper_arm"),
            ("lower_arm", "forearm"),
            ("upper_leg", "thigh"),
            ("lower_leg", "shin"),
        )
    }
    return {
        "hips": (f"{prefix}hips", spine),
        "spine": ((f"{spine}.001", f"{spine}.002", f"{spine}.003"), (f"{spine}", f"{prefix}chest")),
        "neck": ((f"{spine}.004", f"{spine}.005"), f"{prefix}neck"),
        "head": (f"{spine}.006", f"{prefix}head"),
        "collar": (f"{prefix}shoulder.{{side}}",),
        **limbs,
        "hand": (f"{prefix}hand.{{side}}",),
        "foot": (f"{prefix}foot.{{side}}",),
        "toe": (f"{prefix}toe.{{side}}",),
        **fingers(f"{prefix}{{finger}}.0{{joint}}.{{side}}", _THUMB),
    }


FAMILIES = (
    Family("rigify", "Rigify", _parts("DEF-"), marks=("defspine", "defforearml")),
    Family("rigify_metarig", "Rigify metarig", _parts(""), marks=("spine006", "heel02l")),
)

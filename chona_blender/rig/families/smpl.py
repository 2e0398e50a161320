"""SMPL, SMPL-H and SMPL-X, as the models name their joints and as the add-ons for Blender name their bones.

Bones carry the names of the joints they start at: ``left_hip`` is the thigh, ``left_foot`` the toes.
"""

from __future__ import annotations

from .family import Family, fingers

_PARTS = {
    "hips": ("pelvis", "hips"),
    "spine": (("spine1", "spine2", "spine3"), ("spine_1", "spine_2", "spine_3"), ("spine", "spine1", "spine2")),
    "neck": ("neck",),
    "head": ("head",),
    "collar": ("{side}_collar", "{side}_thorax"),
    "upper_arm": ("{side}_shoulder",),
    "lower_arm": ("{side}_elbow",),
    "hand": ("{side}_wrist",),
    "knuckles": ("{side}_hand",),
    "upper_leg": ("{side}_hip",),
    "lower_leg": ("{side}_knee",),
    "foot": ("{side}_ankle",),
    "toe": ("{side}_foot", "{side}_toe"),
    **fingers("{side}_{finger}{joint}"),
}

FAMILIES = (
    Family(
        "smpl",
        "SMPL / SMPL-X",
        _PARTS,
        sides=(("left", "right"), ("L", "R")),
        prefix="[fm]avg",
        marks=("leftcollar", "lcollar", "spine3"),
    ),
)

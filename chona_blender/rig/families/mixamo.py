"""Mixamo, with its namespace (``mixamorig:``, ``mixamorig1:``) or without."""

from __future__ import annotations

from .family import Family, fingers

_FINGERS = {"thumb": "Thumb", "index": "Index", "middle": "Middle", "ring": "Ring", "pinky": "Pinky"}

FAMILIES = (
    Family(
        "mixamo",
        "Mixamo",
        {
            "hips": ("Hips",),
            "spine": (("Spine", "Spine1", "Spine2"),),
            "neck": ("Neck",),
            "head": ("Head",),
            "collar": ("{side}Shoulder",),
            "upper_arm": ("{side}Arm",),
            "lower_arm": ("{side}ForeArm",),
            "hand": ("{side}Hand",),
            "upper_leg": ("{side}UpLeg",),
            "lower_leg": ("{side}Leg",),
            "foot": ("{side}Foot",),
            "toe": ("{side}ToeBase",),
            **fingers("{side}Hand{finger}{joint}", _FINGERS),
        },
        sides=(("Left", "Right"),),
        prefix=r"mixamorig\d*",
        marks=("headtopend", "lefthandthumb1", "spine2"),
    ),
)

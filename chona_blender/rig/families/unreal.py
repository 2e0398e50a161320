"""The Unreal mannequins: three spine bones and one neck bone (UE4), five and two (UE5)."""

from __future__ import annotations

from .family import Family, fingers

FAMILIES = (
    Family(
        "unreal",
        "Unreal mannequin",
        {
            "hips": ("pelvis",),
            "spine": (
                ("spine_01", "spine_02", "spine_03", "spine_04", "spine_05"),
                ("spine_01", "spine_02", "spine_03"),
            ),
            "neck": (("neck_01", "neck_02"), "neck_01"),
            "head": ("head",),
            "collar": ("clavicle_{side}",),
            "upper_arm": ("upperarm_{side}",),
            "lower_arm": ("lowerarm_{side}",),
            "hand": ("hand_{side}",),
            "upper_leg": ("thigh_{side}",),
            "lower_leg": ("calf_{side}",),
            "foot": ("foot_{side}",),
            "toe": ("ball_{side}",),
            **fingers("{finger}_0{joint}_{side}"),
        },
        sides=(("l", "r"),),
        marks=("ikfootroot", "ikhandroot", "upperarmtwist01l", "lowerarmtwist01l", "spine05", "neck02"),
    ),
)

"""MPFB and MakeHuman: the default skeleton, the game engine skeleton and the CMU skeleton.

In the default skeleton every limb has two bones and the spine's numbers run downwards: ``spine05`` sits on the pelvis,
``spine01`` is the chest.  Bones ``pelvis.L`` and ``LHipJoint`` lie between the pelvis and the thighs.
"""

from __future__ import annotations

from .family import Family, fingers

_NUMBERS = {"thumb": "1", "index": "2", "middle": "3", "ring": "4", "pinky": "5"}
_CMU_HAND = {f"{part}1": (f"{{side}}Hand{word}1",) for part, word in (("index", "Finger"),)}

FAMILIES = (
    Family(
        "mpfb_default",
        "MPFB default",
        {
            "hips": ("root",),
            "spine": (("spine05", "spine04", "spine03", "spine02", "spine01"),),
            "neck": (("neck01", "neck02", "neck03"),),
            "head": ("head",),
            "collar": (("clavicle.{side}", "shoulder01.{side}"),),
            "upper_arm": (("upperarm01.{side}", "upperarm02.{side}"),),
            "lower_arm": (("lowerarm01.{side}", "lowerarm02.{side}"),),
            "hand": ("wrist.{side}",),
            "upper_leg": (("upperleg01.{side}", "upperleg02.{side}"),),
            "lower_leg": (("lowerleg01.{side}", "lowerleg02.{side}"),),
            "foot": ("foot.{side}",),
            "toe": ("toe2-1.{side}", "toe1-1.{side}"),
            **fingers("finger{finger}-{joint}.{side}", _NUMBERS),
        },
        marks=("spine05", "upperarm01l", "neck03"),
    ),
    Family(
        "mpfb_game_engine",
        "MPFB game engine",
        {
            "hips": ("pelvis",),
            "spine": (("spine_01", "spine_02", "spine_03"),),
            "neck": ("neck_01",),
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
        exact_marks=("Root",),
    ),
    Family(
        "mpfb_cmu",
        "MPFB CMU",
        {
            "hips": ("Hips",),
            "spine": (("LowerBack", "Spine", "Spine1"),),
            "neck": (("Neck", "Neck1"),),
            "head": ("Head",),
            "collar": ("{side}Shoulder",),
            "upper_arm": ("{side}Arm",),
            "lower_arm": ("{side}ForeArm",),
            "hand": ("{side}Hand",),
            "upper_leg": ("{side}UpLeg",),
            "lower_leg": ("{side}Leg",),
            "foot": ("{side}Foot",),
            "toe": ("{side}ToeBase",),
            **_CMU_HAND,
        },
        sides=(("Left", "Right"),),
        marks=("lowerback", "lhipjoint", "neck1", "leftfingerbase"),
    ),
)

"""VRM and Unity's humanoid: VRoid's bones (``J_Bip_L_UpperArm``) and the names of the humanoid itself."""

from __future__ import annotations

from .family import Family, fingers

_LITTLE = {"thumb": "Thumb", "index": "Index", "middle": "Middle", "ring": "Ring", "pinky": "Little"}
_JOINTS = {"1": "Proximal", "2": "Intermediate", "3": "Distal"}


def _unity_fingers() -> dict:
    return {
        f"{finger}{joint}": (f"{{side}}{word}{bone}", f"{{side}}Hand{word}{joint}")
        for finger, word in _LITTLE.items()
        for joint, bone in _JOINTS.items()
    }


FAMILIES = (
    Family(
        "vrm",
        "VRM (VRoid)",
        {
            "hips": ("J_Bip_C_Hips",),
            "spine": (("J_Bip_C_Spine", "J_Bip_C_Chest", "J_Bip_C_UpperChest"), ("J_Bip_C_Spine", "J_Bip_C_Chest")),
            "neck": ("J_Bip_C_Neck",),
            "head": ("J_Bip_C_Head",),
            "collar": ("J_Bip_{side}_Shoulder",),
            "upper_arm": ("J_Bip_{side}_UpperArm",),
            "lower_arm": ("J_Bip_{side}_LowerArm",),
            "hand": ("J_Bip_{side}_Hand",),
            "upper_leg": ("J_Bip_{side}_UpperLeg",),
            "lower_leg": ("J_Bip_{side}_LowerLeg",),
            "foot": ("J_Bip_{side}_Foot",),
            "toe": ("J_Bip_{side}_ToeBase",),
            **fingers("J_Bip_{side}_{finger}{joint}", _LITTLE),
        },
        marks=("jbipchips",),
    ),
    Family(
        "unity",
        "Unity humanoid",
        {
            "hips": ("Hips",),
            "spine": (("Spine", "Chest", "UpperChest"), ("Spine", "Chest")),
            "neck": ("Neck",),
            "head": ("Head",),
            "collar": ("{side}Shoulder",),
            "upper_arm": ("{side}UpperArm",),
            "lower_arm": ("{side}LowerArm",),
            "hand": ("{side}Hand",),
            "upper_leg": ("{side}UpperLeg",),
            "lower_leg": ("{side}LowerLeg",),
            "foot": ("{side}Foot",),
            "toe": ("{side}Toes", "{side}ToeBase"),
            **_unity_fingers(),
        },
        sides=(("Left", "Right"), ("L", "R")),
        marks=("upperchest",),
    ),
)

"""Which family bone names belong to, and what is missing; without Blender."""

from __future__ import annotations

import pytest

from chona_blender.rig.families import FAMILIES
from chona_blender.rig.families.family import plain
from chona_blender.rig.names import name_key
from chona_blender.rig.recognition import recognise

MIXAMO = [
    "Hips", "Spine", "Spine1", "Spine2", "Neck", "Head",
    *(f"{s}{w}" for s in ("Left", "Right") for w in (
        "Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")),
]  # fmt: skip
UNREAL = [
    "pelvis", "spine_01", "spine_02", "spine_03", "neck_01", "head",
    *(f"{w}_{s}" for s in "lr" for w in (
        "clavicle", "upperarm", "lowerarm", "hand", "thigh", "calf", "foot", "ball")),
]  # fmt: skip


@pytest.mark.parametrize("prefix", ["", "mixamorig:", "mixamorig7:", "mixamorig_", "Armature|mixamorig:"])
def test_namespaces_do_not_matter(prefix: str) -> None:
    found = recognise([prefix + name for name in MIXAMO])
    assert found.label == "Mixamo" and found.missing == ()
    assert found.parts["upper_arm.L"] == (f"{prefix}LeftArm",)
    assert found.parts["spine"] == tuple(f"{prefix}{name}" for name in ("Spine", "Spine1", "Spine2"))


def test_joints_are_not_taken_for_bones() -> None:
    """SMPL's left_foot are the toes and its left_shoulder is the upper arm; Mixamo's are not."""
    smpl = recognise(["pelvis", "spine1", "spine2", "spine3", "neck", "head", *(
        f"{s}_{w}" for s in ("left", "right") for w in (
            "collar", "shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle", "foot"))])  # fmt: skip
    assert smpl.parts["toe.L"] == ("left_foot",) and smpl.parts["upper_arm.R"] == ("right_shoulder",)
    mixamo = recognise(MIXAMO)
    assert mixamo.parts["foot.L"] == ("LeftFoot",) and mixamo.parts["collar.R"] == ("RightShoulder",)


def test_the_mannequin_and_mpfbs_game_engine_rig_differ_by_a_letter() -> None:
    assert recognise(["root", *UNREAL]).label == "Unreal mannequin"
    assert recognise(["Root", *UNREAL]).label == "MPFB game engine"


def test_what_is_missing_is_named() -> None:
    found = recognise([name for name in MIXAMO if name not in ("LeftForeArm", "RightFoot")])
    assert found.label == "Mixamo"
    assert set(found.missing) == {"lower_arm.L", "foot.R"}


def test_gaps_are_filled_with_left_and_right_names() -> None:
    names = [name for name in UNREAL if name != "calf_l"]
    assert recognise([*names, "shin.L"]).parts["lower_leg.L"] == ("shin.L",)


def test_helpers_are_not_taken_for_limbs() -> None:
    limbs = ["arm twist", "arm", "forearm", "hand ik", "hand", "thigh", "shin pole", "shin", "foot roll", "foot"]
    names = ["hips", "spine", "neck", "head", *(f"{word}.{side}" for side in "LR" for word in limbs)]
    parts = recognise(names).parts
    found = {part: bones for part, bones in parts.items() if part.endswith(".R")}
    assert found["upper_arm.R"] == ("arm.R",) and found["hand.R"] == ("hand.R",)
    assert found["lower_leg.R"] == ("shin.R",) and found["foot.R"] == ("foot.R",)


@pytest.mark.parametrize("names", [[], ["Bone"], ["Bone", "Bone.001", "Bone.002"], ["door", "hinge.L"]])
def test_things_are_not_people(names: list[str]) -> None:
    found = recognise(names)
    assert found.family is None and found.parts == {}


def test_every_family_has_its_own_name_and_finds_its_own_spelling() -> None:
    """Each table's first spelling of every part, found again by the table itself."""
    assert len({family.name for family in FAMILIES}) == len(FAMILIES)
    for family in FAMILIES[:-1]:
        words = family.sides[0]
        names: dict[str, None] = {}
        for spellings in family.parts.values():
            chain = (spellings[0],) if isinstance(spellings[0], str) else spellings[0]
            for name in chain:
                names |= dict.fromkeys(name.replace("{side}", word) for word in words)
        if family.name == "rigify":
            names |= {"DEF-spine": None}
        found = family.find(names)
        assert found.missing == [], family.name
        assert len({plain(bone) for bones in found.parts.values() for bone in bones}) >= 17, family.name


@pytest.mark.parametrize("name", ["left_hip", "L_Hip", "hip.L", "LeftHip", "mixamorig:LeftHip", "DEF-hip.L"])
def test_spellings_of_one_name(name: str) -> None:
    assert name_key(name) == ("L", "hip")

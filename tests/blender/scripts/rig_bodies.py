"""A body, and armatures of every rig family with its proportions: names, hierarchy, rest pose, axes, rolls, unit."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import radians

import bpy
import numpy as np
from bpy.types import Object
from mathutils import Matrix, Vector

SMPL = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
SMPL_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
_HALF = {
    "pelvis": (0.0, 0.95, 0.0), "spine1": (0.0, 1.06, -0.02), "spine2": (0.0, 1.19, -0.01), "spine3": (0.0, 1.25, 0.0),
    "neck": (0.0, 1.46, -0.04), "head": (0.0, 1.55, 0.01), "top": (0.0, 1.75, 0.0),
    "hip": (0.09, 0.87, 0.01), "knee": (0.1, 0.48, 0.02), "ankle": (0.1, 0.08, -0.03), "foot": (0.12, 0.02, 0.1),
    "collar": (0.07, 1.38, -0.02), "shoulder": (0.17, 1.4, -0.03), "elbow": (0.43, 1.4, -0.03),
    "wrist": (0.68, 1.4, -0.03), "hand": (0.76, 1.4, -0.03), "index": (0.77, 1.4, 0.0), "pinky": (0.75, 1.4, -0.08),
    "tip": (0.8, 1.4, -0.03),
}  # fmt: skip
"""Canonical joints of the middle and the left side."""


def joint(name: str, side: str = "") -> np.ndarray:
    """A canonical joint [3], T-pose."""
    point = np.array(_HALF[name])
    return point * [-1.0, 1.0, 1.0] if side == "R" else point


def smpl_joints() -> np.ndarray:
    """[24, 3] of the body."""
    sides = {"left": "L", "right": "R"}
    rows = []
    for name in SMPL:
        side, _, word = name.partition("_")
        rows.append(joint(word, sides[side]) if word else joint(name))
    return np.array(rows)


@dataclass(frozen=True)
class Rest:
    """How a family rests: arms lowered, elbows bent forward, palms turned, legs apart, in degrees."""

    lowered: float = 0.0
    bent: float = 0.0
    palms: float = 0.0
    apart: float = 0.0

    def place(self, name: str, side: str) -> np.ndarray:
        """A canonical joint in this rest pose."""
        point, sign = joint(name, side), -1.0 if side == "R" else 1.0
        if name in ("index", "pinky", "tip"):
            point = _turn(point, joint("wrist", side), (1.0, 0.0, 0.0), self.palms)
        if name in ("wrist", "hand", "index", "pinky", "tip"):
            point = _turn(point, joint("elbow", side), (0.0, -sign, 0.0), self.bent)
        if name in ("elbow", "wrist", "hand", "index", "pinky", "tip"):
            point = _turn(point, joint("shoulder", side), (0.0, 0.0, -sign), self.lowered)
        if name in ("knee", "ankle", "foot"):
            point = _turn(point, joint("hip", side), (0.0, 0.0, sign), self.apart)
        return point


def _turn(point: np.ndarray, centre: np.ndarray, axis: tuple[float, ...], degrees: float) -> np.ndarray:
    return centre + np.array(Matrix.Rotation(radians(degrees), 3, Vector(axis))) @ (point - centre)


@dataclass(frozen=True)
class Rig:
    """One family's armature.

    Attributes:
        bones: name, parent, joint; a joint is 'wrist', or 'shoulder>elbow:0.5' on the way between two.
        side_words: what {s} stands for.
        unit: armature units in a metre.
        axes: degrees by which the armature's data is turned about x; 90 is Blender's z up.
        label: the family that must be recognised.
        fixed: bones that the animator does not turn.
    """

    label: str
    bones: tuple[tuple[str, str, str], ...]
    sides: tuple[str, str] = ("L", "R")
    rest: Rest = field(default_factory=Rest)
    unit: float = 1.0
    axes: float = 90.0
    fixed: tuple[str, ...] = ()


def _spread(*rows: str) -> tuple[tuple[str, str, str], ...]:
    return tuple(tuple(part.strip() for part in row.split("|")) for row in rows)  # type: ignore[misc]


def chain(names: str, parent: str, joints: str) -> tuple[tuple[str, str, str], ...]:
    """Bones that hang one on the other: names and joints with spaces between."""
    rows = []
    for name, at in zip(names.split(), joints.split(), strict=True):
        rows.append((name.replace("~", " "), parent, at))
        parent = name.replace("~", " ")
    return tuple(rows)


ARM = "collar shoulder elbow wrist"
LEG = "hip knee ankle foot"
SPLIT_ARM = "shoulder shoulder>elbow:0.5 elbow elbow>wrist:0.5 wrist"
SPLIT_LEG = "hip hip>knee:0.5 knee knee>ankle:0.5 ankle foot"
SPINE5 = "pelvis>spine1:0.6 spine1>spine2:0.3 spine1>spine2:0.9 spine2>spine3:0.7 spine3"


def _hand(prefix: str, parent: str, index: str, middle: str, pinky: str) -> tuple[tuple[str, str, str], ...]:
    return ((prefix + index, parent, "index"), (prefix + middle, parent, "hand"), (prefix + pinky, parent, "pinky"))


M = "mixamorig:"
RIGS = {
    "smplx": Rig(
        "SMPL / SMPL-X",
        chain("root pelvis spine1 spine2 spine3 neck head", "", "pelvis pelvis spine1 spine2 spine3 neck head")
        + chain("{s}_collar {s}_shoulder {s}_elbow {s}_wrist", "spine3", ARM)
        + chain("{s}_hip {s}_knee {s}_ankle {s}_foot", "pelvis", LEG)
        + _hand("{s}_", "{s}_wrist", "index1", "middle1", "pinky1"),
        ("left", "right"),
    ),
    "smpl": Rig(
        "SMPL / SMPL-X",
        chain("Pelvis Spine1 Spine2 Spine3 Neck Head", "", "pelvis spine1 spine2 spine3 neck head")
        + chain("{s}_Collar {s}_Shoulder {s}_Elbow {s}_Wrist {s}_Hand", "Spine3", ARM + " hand")
        + chain("{s}_Hip {s}_Knee {s}_Ankle {s}_Foot", "Pelvis", LEG),
        rest=Rest(apart=6.0),
        axes=0.0,
    ),
    "rigify": Rig(
        "Rigify",
        chain(
            "DEF-spine DEF-spine.001 DEF-spine.002 DEF-spine.003 DEF-spine.004 DEF-spine.005 DEF-spine.006", "",
            "pelvis pelvis>spine1:0.9 spine2 spine3 neck neck>head:0.5 head",
        )
        + (("DEF-shoulder.{s}", "DEF-spine.003", "collar"),)
        + chain(
            "DEF-upper_arm.{s} DEF-upper_arm.{s}.001 DEF-forearm.{s} DEF-forearm.{s}.001 DEF-hand.{s}",
            "DEF-shoulder.{s}", SPLIT_ARM,
        )
        + chain(
            "DEF-thigh.{s} DEF-thigh.{s}.001 DEF-shin.{s} DEF-shin.{s}.001 DEF-foot.{s} DEF-toe.{s}",
            "DEF-spine", SPLIT_LEG,
        )
        + _hand("DEF-", "DEF-hand.{s}", "f_index.01.{s}", "f_middle.01.{s}", "f_pinky.01.{s}"),
        rest=Rest(lowered=30.0, bent=8.0),
    ),
    "mixamo": Rig(
        "Mixamo",
        chain(f"{M}Hips {M}Spine {M}Spine1 {M}Spine2 {M}Neck {M}Head", "", "pelvis spine1 spine2 spine3 neck head")
        + chain(f"{M}{{s}}Shoulder {M}{{s}}Arm {M}{{s}}ForeArm {M}{{s}}Hand", f"{M}Spine2", ARM)
        + chain(f"{M}{{s}}UpLeg {M}{{s}}Leg {M}{{s}}Foot {M}{{s}}ToeBase", f"{M}Hips", LEG)
        + _hand(f"{M}{{s}}Hand", f"{M}{{s}}Hand", "Index1", "Middle1", "Pinky1"),
        ("Left", "Right"),
        unit=100.0,
        axes=0.0,
    ),
    "mixamo A-pose": Rig(
        "Mixamo",
        chain("Hips Spine Spine1 Spine2 Neck Head", "", "pelvis spine1 spine2 spine3 neck head")
        + chain("{s}Shoulder {s}Arm {s}ForeArm {s}Hand", "Spine2", ARM)
        + chain("{s}UpLeg {s}Leg {s}Foot {s}ToeBase", "Hips", LEG),
        ("Left", "Right"),
        rest=Rest(lowered=50.0, bent=15.0, apart=8.0),
        unit=100.0,
        axes=0.0,
    ),
    "mpfb default": Rig(
        "MPFB default",
        chain("root spine05 spine04 spine03 spine02 spine01 neck01 neck02 neck03 head", "",
              f"pelvis {SPINE5} neck neck>head:0.3 neck>head:0.7 head")
        + chain("clavicle.{s} shoulder01.{s}", "spine01", "collar collar>shoulder:0.6")
        + chain("upperarm01.{s} upperarm02.{s} lowerarm01.{s} lowerarm02.{s} wrist.{s}", "shoulder01.{s}", SPLIT_ARM)
        + (("pelvis.{s}", "root", "pelvis"),)
        + chain(
            "upperleg01.{s} upperleg02.{s} lowerleg01.{s} lowerleg02.{s} foot.{s} toe2-1.{s}", "pelvis.{s}", SPLIT_LEG
        )
        + _hand("", "wrist.{s}", "finger2-1.{s}", "finger3-1.{s}", "finger5-1.{s}"),
        rest=Rest(lowered=45.0, bent=40.0, palms=30.0, apart=5.0),
    ),
    "mpfb game engine": Rig(
        "MPFB game engine",
        chain("Root pelvis spine_01 spine_02 spine_03 neck_01 head", "", "pelvis pelvis spine1 spine2 spine3 neck head")
        + chain("clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s}", "spine_03", ARM)
        + chain("thigh_{s} calf_{s} foot_{s} ball_{s}", "pelvis", LEG)
        + _hand("", "hand_{s}", "index_01_{s}", "middle_01_{s}", "pinky_01_{s}"),
        ("l", "r"),
        rest=Rest(lowered=45.0, bent=40.0, apart=5.0),
    ),
    "mpfb cmu": Rig(
        "MPFB CMU",
        chain("Hips LowerBack Spine Spine1 Neck Neck1 Head", "", "pelvis spine1 spine2 spine3 neck neck>head:0.5 head")
        + chain("{s}Shoulder {s}Arm {s}ForeArm {s}Hand {s}FingerBase", "Spine1", f"{ARM} hand")
        + chain("{t}HipJoint {s}UpLeg {s}Leg {s}Foot {s}ToeBase", "Hips", f"pelvis {LEG}"),
        ("Left", "Right"),
        rest=Rest(lowered=45.0, bent=40.0, apart=5.0),
    ),
    "unreal": Rig(
        "Unreal mannequin",
        chain("root pelvis spine_01 spine_02 spine_03 neck_01 head", "", "pelvis pelvis spine1 spine2 spine3 neck head")
        + chain("clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s}", "spine_03", ARM)
        + (("upperarm_twist_01_{s}", "upperarm_{s}", "shoulder>elbow:0.5"),
           ("lowerarm_twist_01_{s}", "lowerarm_{s}", "elbow>wrist:0.6"), ("ik_hand_{s}", "root", "wrist"))
        + chain("thigh_{s} calf_{s} foot_{s} ball_{s}", "pelvis", LEG)
        + _hand("", "hand_{s}", "index_01_{s}", "middle_01_{s}", "pinky_01_{s}"),
        ("l", "r"),
        rest=Rest(lowered=48.0, bent=18.0, palms=-20.0, apart=4.0),
        unit=100.0,
    ),
    "unreal 5": Rig(
        "Unreal mannequin",
        chain("pelvis spine_01 spine_02 spine_03 spine_04 spine_05 neck_01 neck_02 head", "",
              f"pelvis {SPINE5} neck neck>head:0.5 head")
        + chain("clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s}", "spine_05", ARM)
        + chain("thigh_{s} calf_{s} foot_{s} ball_{s}", "pelvis", LEG),
        ("l", "r"),
        rest=Rest(lowered=48.0, bent=18.0, apart=4.0),
        unit=100.0,
    ),
    "vrm": Rig(
        "VRM (VRoid)",
        chain("Root J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_UpperChest J_Bip_C_Neck J_Bip_C_Head", "",
              "pelvis pelvis spine1 spine2 spine3 neck head")
        + chain("J_Bip_{s}_Shoulder J_Bip_{s}_UpperArm J_Bip_{s}_LowerArm J_Bip_{s}_Hand", "J_Bip_C_UpperChest", ARM)
        + chain("J_Bip_{s}_UpperLeg J_Bip_{s}_LowerLeg J_Bip_{s}_Foot J_Bip_{s}_ToeBase", "J_Bip_C_Hips", LEG)
        + _hand("J_Bip_{s}_", "J_Bip_{s}_Hand", "Index1", "Middle1", "Little1"),
    ),
    "unity": Rig(
        "Unity humanoid",
        chain("Hips Spine Chest Neck Head", "", "pelvis spine1 spine3 neck head")
        + chain("{s}Shoulder {s}UpperArm {s}LowerArm {s}Hand", "Chest", ARM)
        + chain("{s}UpperLeg {s}LowerLeg {s}Foot {s}Toes", "Hips", LEG),
        ("Left", "Right"),
        axes=0.0,
    ),
    "generic": Rig(
        "left and right names",
        chain("Bip01 Bip01~Pelvis Bip01~Spine Bip01~Spine1 Bip01~Neck Bip01~Head", "",
              "pelvis pelvis spine1 spine3 neck head")
        + chain("Bip01~{s}~Clavicle Bip01~{s}~UpperArm Bip01~{s}~Forearm Bip01~{s}~Hand", "Bip01 Spine1", ARM)
        + chain("Bip01~{s}~Thigh Bip01~{s}~Calf Bip01~{s}~Foot Bip01~{s}~Toe0", "Bip01 Pelvis", LEG),
        rest=Rest(lowered=20.0),
    ),
}  # fmt: skip


def rows_of(rig: Rig) -> list[tuple[str, str, np.ndarray]]:
    """Name, parent and head of every bone, parents first; heads in canonical axes and metres, at rest."""
    rows = []
    for name, parent, at in rig.bones:
        both = "{s}" in name or "{t}" in name
        for side, word in zip("LR", rig.sides, strict=True) if both else (("", ""),):
            full, above = (text.replace("{s}", word).replace("{t}", side) for text in (name, parent))
            first, _, way = at.partition(">")
            point = rig.rest.place(first, side)
            if way:
                second, share = way.split(":")
                point = point + float(share) * (rig.rest.place(second, side) - point)
            rows.append((full, above, point))
    return rows


def build(rig: Rig, seed: int = 0) -> Object:
    """The armature in the active scene, with random rolls."""
    random = np.random.default_rng(seed)
    data = bpy.data.armatures.new("rig")
    item = bpy.data.objects.new("rig", data)
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    turn = Matrix.Rotation(radians(rig.axes), 3, "X")
    rows = rows_of(rig)
    heads = {name: turn @ Vector(point) * rig.unit for name, _, point in rows}
    bpy.ops.object.mode_set(mode="EDIT")
    for name, parent, _ in rows:
        bone = data.edit_bones.new(name)
        children = [heads[other] for other, above, _ in rows if above == name]
        tail = children[0] if children else heads[name] + Vector((0.0, 0.0, 0.06 * rig.unit))
        if (tail - heads[name]).length < 1e-4 * rig.unit:
            tail = heads[name] + Vector((0.0, 0.05 * rig.unit, 0.0))
        bone.head, bone.tail, bone.roll = heads[name], tail, float(random.uniform(-3.0, 3.0))
        bone.use_connect = False
        if parent:
            bone.parent = data.edit_bones[parent]
    bpy.ops.object.mode_set(mode="OBJECT")
    item.scale = (1.0 / rig.unit,) * 3
    if rig.axes == 0.0:
        item.rotation_euler = (radians(90.0), 0.0, 0.0)
    return item


def animate(item: Object, rig: Rig, seed: int = 1, frames: tuple[int, ...] = (1, 2, 3, 4), amount: float = 0.3) -> None:
    """Keys random rotations on every bone and moves the first one that has children on both sides."""
    random = np.random.default_rng(seed)
    for frame in frames:
        for bone in item.pose.bones:
            bone.rotation_mode = "XYZ"
            turn = random.normal(0.0, amount, 3)
            if re.search(r"\.001$|(arm|leg)02", bone.name):
                turn *= (0.05, 1.0, 0.05)  # segments twist; they hardly bend
            bone.rotation_euler = turn
            bone.keyframe_insert("rotation_euler", frame=frame)
            if bone.parent is None:
                bone.location = random.normal(0.0, 0.2, 3) * rig.unit
                bone.keyframe_insert("location", frame=frame)

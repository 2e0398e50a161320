"""Performances: what Robin does with the crate, as rotations of bones found by two-bone inverse kinematics.

Blender's axes (z up, facing −y), metres, the figure's own place as origin.  Plain numpy: nothing here needs bpy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from demo.body import BONES, PARENTS, rest_joints

CRATE_HALF = np.array([0.17, 0.13, 0.12])
"""Half the crate's sides, metres."""

PALM_GAP = 0.028
"""From the crate's side to the bones of the hand, metres."""

BONE = {name: index for index, name in enumerate(BONES)}
SPINE = ("spine1", "spine2", "spine3")


@dataclass(frozen=True)
class Stance:
    """What one moment of a performance asks for.

    Attributes:
        pelvis: [3] shift of the pelvis from its rest place, metres.
        turn: of the whole body about the vertical, radians (the feet turn along).
        bend: forward bend of the spine; twist: of the chest about the vertical; tilt: of the head down; radians.
        crate: [3] middle of the crate; yaw, roll: of the crate about the vertical and about x, radians.
    """

    pelvis: tuple[float, float, float]
    turn: float
    bend: float
    twist: float
    tilt: float
    crate: tuple[float, float, float]
    yaw: float = 0.0
    roll: float = 0.0


@dataclass(frozen=True)
class Moment:
    """A solved pose.

    Attributes:
        rotations: [24, 3, 3] of every bone from its rest orientation, in the figure's axes (not relative to parents).
        pelvis: [3] posed pelvis joint, metres.
        joints: [24, 3] posed joints.
        crate: [4, 4] the crate's frame.
    """

    rotations: np.ndarray
    pelvis: np.ndarray
    joints: np.ndarray
    crate: np.ndarray


def axis_rotation(axis: str, angle: float) -> np.ndarray:
    """Right-handed rotation about x, y or z."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def frame(along: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Orthonormal axes: x along one direction, y as near to the other as can be."""
    x = along / np.linalg.norm(along)
    z = np.cross(x, towards)
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def solve(stance: Stance) -> Moment:
    """Spine from the stance's angles, legs to feet on the floor, arms to the crate's sides."""
    rest = rest_joints()
    body = axis_rotation("z", stance.turn)
    rotations = np.broadcast_to(np.eye(3), (len(BONES), 3, 3)).copy()
    rotations[BONE["pelvis"]] = body @ axis_rotation("x", 0.25 * stance.bend)
    for number, name in enumerate(SPINE, start=1):
        share = number / len(SPINE)
        rotations[BONE[name]] = (
            body @ axis_rotation("z", stance.twist * share) @ axis_rotation("x", stance.bend * (0.25 + 0.75 * share))
        )
    chest = rotations[BONE["spine3"]]
    for name in ("neck", "left_collar", "right_collar"):
        rotations[BONE[name]] = chest
    rotations[BONE["head"]] = body @ axis_rotation("z", 0.7 * stance.twist) @ axis_rotation("x", stance.tilt)

    crate = np.eye(4)
    crate[:3, :3] = axis_rotation("z", stance.yaw) @ axis_rotation("x", stance.roll)
    crate[:3, 3] = stance.crate
    joints = _follow(rest, rotations, rest[0] + np.array(stance.pelvis))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        ankle = body @ rest[BONE[f"{side}_ankle"]]
        hip, knee = f"{side}_hip", f"{side}_knee"
        _reach(
            rotations, joints, rest, (hip, knee, f"{side}_ankle"), ankle, body @ [0.15 * sign, -1.0, 0.0], [0, -1.0, 0]
        )
        for name in (f"{side}_ankle", f"{side}_foot"):
            rotations[BONE[name]] = body
        # Wrists lie behind the middle of the crate's sides, so that the palms rest on them.
        wrist = crate[:3, :3] @ [sign * (CRATE_HALF[0] + PALM_GAP), 0.075, -0.01] + crate[:3, 3]
        elbow = body @ [0.55 * sign, 0.75, -0.6]
        names = (f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist")
        _reach(rotations, joints, rest, names, wrist, elbow, [0, 1.0, 0])
        resting = frame(np.array([sign, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]))
        holding = frame(crate[:3, :3] @ [-0.06 * sign, -1.0, 0.05], crate[:3, :3] @ [-sign, 0.0, 0.0])
        for name in (f"{side}_wrist", f"{side}_hand"):
            rotations[BONE[name]] = holding @ resting.T
    joints = _follow(rest, rotations, rest[0] + np.array(stance.pelvis))
    return Moment(rotations, joints[0], joints, crate)


def _follow(rest: np.ndarray, rotations: np.ndarray, pelvis: np.ndarray) -> np.ndarray:
    joints = np.zeros_like(rest)
    joints[0] = pelvis
    for index, parent in enumerate(PARENTS):
        if parent >= 0:
            joints[index] = joints[parent] + rotations[parent] @ (rest[index] - rest[parent])
    return joints


def _reach(
    rotations: np.ndarray, joints: np.ndarray, rest: np.ndarray, chain: tuple[str, str, str], target: np.ndarray,
    pole: np.ndarray, rest_pole: list[float],
) -> None:  # fmt: skip
    """Turns the two bones of a limb so that its end meets the target, or comes as near as it can."""
    root, middle, end = (BONE[name] for name in chain)
    upper, lower = rest[middle] - rest[root], rest[end] - rest[middle]
    a, b = np.linalg.norm(upper), np.linalg.norm(lower)
    line = target - joints[root]
    distance = np.clip(np.linalg.norm(line), abs(a - b) + 1e-3, (a + b) * 0.999)
    axes = frame(line, np.asarray(pole))
    along = (a * a - b * b + distance * distance) / (2.0 * distance)
    bent = joints[root] + along * axes[:, 0] + np.sqrt(max(a * a - along * along, 0.0)) * axes[:, 1]
    tip = joints[root] + distance * axes[:, 0]
    # The pole serves both bones, so that the joint in the middle bends and never twists.
    rotations[root] = frame(bent - joints[root], np.asarray(pole)) @ frame(upper, np.asarray(rest_pole)).T
    rotations[middle] = frame(tip - bent, np.asarray(pole)) @ frame(lower, np.asarray(rest_pole)).T


def _blend(keys: list[tuple[float, Stance]], time: float) -> Stance:
    """Between two keys, eased in and out."""
    times = [key for key, _ in keys]
    index = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(keys) - 2))
    (start, one), (stop, other) = keys[index], keys[index + 1]
    share = float(np.clip((time - start) / (stop - start), 0.0, 1.0))
    share = share * share * (3.0 - 2.0 * share)

    def mix(first, second):  # numbers or tuples of them
        return (1.0 - share) * np.asarray(first) + share * np.asarray(second)

    values = {name: mix(getattr(one, name), getattr(other, name)) for name in Stance.__dataclass_fields__}
    return Stance(**{name: tuple(value) if value.ndim else float(value) for name, value in values.items()})


LOW = Stance((0.0, 0.16, -0.34), 0.0, 0.95, 0.0, 0.55, (0.0, -0.46, 0.42))
HOLD = Stance((0.0, 0.0, -0.02), 0.0, 0.05, 0.0, 0.3, (0.0, -0.36, 1.02))
CHEST = Stance((0.0, 0.0, -0.01), 0.0, -0.05, 0.0, 0.1, (0.0, -0.36, 1.24), 0.0, 0.15)
LEFT = Stance((0.03, 0.0, -0.05), 0.15, 0.15, 0.65, 0.25, (0.30, -0.32, 0.98), 0.75, 0.1)
RIGHT = Stance((-0.03, 0.02, -0.08), -0.2, 0.25, -0.6, 0.3, (-0.31, -0.34, 0.90), -0.7, -0.15)
FORTH = Stance((0.0, 0.03, -0.12), 0.0, 0.45, 0.0, 0.3, (0.0, -0.58, 0.90), 0.0, -0.25)
AROUND = Stance((0.02, 0.0, -0.03), 0.5, 0.1, 0.25, 0.2, (0.22, -0.34, 1.10), 0.65, 0.3)
HIGH = Stance((0.0, 0.0, 0.0), 0.25, -0.12, 0.2, -0.25, (0.10, -0.36, 1.42), 0.35, 0.35)
SHELF = Stance((0.05, -0.02, -0.05), 0.35, 0.3, 0.35, 0.15, (0.26, -0.46, 1.12), 0.6, -0.1)

PERFORMANCES: dict[str, list[tuple[float, Stance]]] = {
    "lift": [(0.0, LOW), (0.45, HOLD), (0.75, CHEST), (1.0, HOLD)],
    "turn": [(0.0, HOLD), (0.3, LEFT), (0.65, RIGHT), (1.0, FORTH)],
    "present": [(0.0, FORTH), (0.35, AROUND), (0.7, HIGH), (1.0, SHELF)],
}
"""Keys of every performance over 0…1. ``present`` is the novel one: training never sees it."""

TRAINED = ("lift", "turn")
NOVEL = "present"


def performance(name: str) -> Callable[[float], Moment]:
    """A performance as a function of time 0…1."""
    keys = PERFORMANCES[name]
    return lambda time: solve(_blend(keys, time))

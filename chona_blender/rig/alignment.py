"""How a model's rest pose is turned into an armature's: axes, unit, and one rotation a bone.

The model rests in a T-pose.  The armature may rest in an A-pose, with bent elbows, with any axes and bone rolls, in
centimetres, and it may belong to another body.  Differences of two kinds are told apart:

* *Limbs and fingers*: where the armature's forearm rests in another direction, that is the rest pose, and the model's
  is turned to it (``swing``, parents before children, so that twist follows the arm).
* *Pelvis, spine, neck, head, shoulder blades and feet* stand upright in both.  Where their joints lie differently,
  that is another convention or another body and not a pose: nothing is turned.  Only where a link has the same length
  in both, and so can be taken for the same bone, its direction counts; and feet keep the heading of their toes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .families.family import FINGERS, MIDDLE, base
from .mapping import RigMapping
from .rest_pose import axis_rotations, fit_axes
from .rotations import about, swing, unit

SAME_LENGTH = 0.05
"""Links whose lengths differ by no more are the same bone in two rest poses."""

SAME_BODY = 0.01
"""Limbs and torso whose lengths agree so well on a scale are a scaled copy, not another body."""

UPRIGHT_WITHIN = np.radians(30.0)
"""Armature axes that come so close to a permutation of the model's are one."""

_TWIST_FROM = np.radians(25.0)
"""Palms that rest turned by less are alike; the knuckles' line is no better known."""

_SWUNG = {"upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg", *FINGERS}
_UPRIGHT = {*MIDDLE, "collar"}
_NEXT = {
    "collar": ("upper_arm",), "upper_arm": ("lower_arm",), "lower_arm": ("hand",), "neck": ("head",),
    "hand": ("knuckles", "middle1", "index1"), "upper_leg": ("lower_leg",), "lower_leg": ("foot",), "foot": ("toe",),
    **{f"{part[:-1]}{joint}": (f"{part[:-1]}{joint + 1}",) for part in FINGERS for joint in (1, 2)},
}  # fmt: skip
_MEASURED = ("upper_arm", "lower_arm", "upper_leg", "lower_leg")


@dataclass(frozen=True)
class Link:
    """A bone whose direction is known: from its own joint to the next one's.

    Attributes:
        start, end: indices of the model's bones whose joints it connects.
        follows: whether the posed bone is to point where the armature's next joint is.
    """

    start: int
    end: int
    follows: bool


@dataclass(frozen=True)
class Alignment:
    """Rest pose of an armature against a model's.

    Attributes:
        axes: [3, 3] armature from canonical.
        unit: armature units in a metre of the model's body; from the lengths of its limbs.
        same_body: limbs and torso have the model's proportions, within a hundredth.
        turns: [B, 3, 3] armature from canonical, a bone each.
        links: for each of B bones, or None.
    """

    axes: np.ndarray
    unit: float
    same_body: bool
    turns: np.ndarray
    links: tuple[Link | None, ...]


def align(mapping: RigMapping, parents: Sequence[int], joints: np.ndarray, heads: dict[str, np.ndarray]) -> Alignment:
    """Aligns an armature's rest pose with a model's.

    Args:
        mapping: of the model's B bones, in their order.
        parents: B indices, -1 for the root.
        joints: [B, 3] the model's rest joints, canonical space, metres.
        heads: rest head [3] of every bone of the armature, in its space.
    """
    names = list(mapping.bones)
    rest = [heads[mapping.bones[name][0]] if mapping.bones[name] else None for name in names]
    ends = _ends(mapping, names, parents)
    found = ({name: at for name, at in zip(names, points, strict=True) if at is not None} for points in (joints, rest))
    torsos = [_torso(mapping, points) for points in found]
    axes = _axes(torsos, joints, rest)
    lengths = {
        index: (np.linalg.norm(joints[end] - joints[start]), np.linalg.norm(rest[end] - rest[start]))
        for index, (start, end) in ends.items()
    }
    limbs = [pair for index, pair in lengths.items() if base(mapping.model.part_of(names[index])[0]) in _MEASURED]
    metre, same_body = _unit(torsos, limbs, joints, rest)
    turns, links = [], []
    for index, name in enumerate(names):
        part = base(mapping.model.part_of(name)[0])
        inherited = turns[parents[index]] if parents[index] >= 0 and part not in _UPRIGHT else axes
        if index not in ends:
            turns.append(inherited)
            links.append(None)
            continue
        start, end = ends[index]
        towards, wanted = joints[end] - joints[start], rest[end] - rest[start]
        length, long = lengths[index]
        same = abs(long / max(metre * length, 1e-9) - 1.0) < SAME_LENGTH
        if part == "foot" and not same:
            turns.append(_heading(axes, towards, wanted))
            links.append(None)
        elif part in _SWUNG or same:
            turns.append(swing(inherited @ towards, wanted) @ inherited)
            links.append(Link(start, end, follows=True))
        else:
            turns.append(inherited)
            links.append(None)
        if part == "hand":
            _turn_palm(mapping, names, joints, heads, turns)
    return Alignment(axes, metre, same_body, np.array(turns), tuple(links))


def _ends(mapping: RigMapping, names: list[str], parents: Sequence[int]) -> dict[int, tuple[int, int]]:
    """For bones with a direction: the model's bones at its start and at its end, both mapped and to different bones."""
    model, place = mapping.model, {name: index for index, name in enumerate(names)}
    found = {}
    for index, name in enumerate(names):
        part, position = model.part_of(name)
        if not mapping.bones[name]:
            continue
        start, end = index, None
        if part:
            bare, side = base(part), part[len(base(part)) :]
            chain = model.parts[part]
            if bare in MIDDLE and position + 1 < len(chain):
                end = place[chain[position + 1]]
            else:
                start = start if bare in MIDDLE else place[chain[0]]
                following = (model.parts.get(next_part + side) for next_part in _NEXT.get(bare, ()))
                end = next((place[each[0]] for each in following if each and mapping.bones[each[0]]), None)
        else:
            children = [
                child for child, parent in enumerate(parents) if parent == index and mapping.bones[names[child]]
            ]
            end = children[0] if len(children) == 1 else None
        if end is None or not mapping.bones[names[end]] or not mapping.bones[names[start]]:
            continue
        if mapping.bones[names[start]][0] != mapping.bones[names[end]][0]:
            found[index] = (start, end)
    return found


def _torso(mapping: RigMapping, points: dict[str, np.ndarray]) -> tuple[np.ndarray, float] | None:
    """Axes [3, 3] (left, up, front) of a torso and its length from hips to shoulders; points by the model's bones."""
    found = {}
    for part in ("upper_leg", "upper_arm"):
        pair = [mapping.model.parts.get(f"{part}.{side}", ("",))[0] for side in "LR"]
        if not all(bone in points for bone in pair):
            return None
        found[part] = np.array([points[bone] for bone in pair])
    line = found["upper_arm"].mean(axis=0) - found["upper_leg"].mean(axis=0)
    up = unit(line)
    left = sum(pair[0] - pair[1] for pair in found.values())
    left = unit(left - up * (left @ up))
    return np.stack([left, up, np.cross(left, up)], axis=-1), float(np.linalg.norm(line))


def _axes(
    torsos: list[tuple[np.ndarray, float] | None], joints: np.ndarray, rest: list[np.ndarray | None]
) -> np.ndarray:
    """Armature from canonical: by the axes of both torsos, else by all joints."""
    if torsos[0] is None or torsos[1] is None:
        mapped = [index for index, head in enumerate(rest) if head is not None]
        found = np.array([rest[index] for index in mapped]).reshape(-1, 3)
        if len(mapped) < 2 or np.ptp(found, axis=0).max() < 1e-9:
            return axis_rotations()[0]
        chosen = joints[mapped]
        return fit_axes(chosen - chosen.mean(axis=0), found - found.mean(axis=0))[0]
    raw = torsos[1][0] @ torsos[0][0].T
    closest = max(axis_rotations(), key=lambda each: float(np.trace(each.T @ raw)))
    cosine = (np.trace(closest.T @ raw) - 1.0) / 2.0
    return closest if cosine > np.cos(UPRIGHT_WITHIN) else raw


def _unit(
    torsos: list[tuple[np.ndarray, float] | None],
    limbs: list[tuple[float, float]],
    joints: np.ndarray,
    rest: list[np.ndarray | None],
) -> tuple[float, bool]:
    """Armature units in a metre of the model by its limbs, and whether limbs and torso all agree on them."""
    pairs = [pair for pair in limbs if min(pair) > 1e-9]
    if not pairs:
        mapped = [index for index, head in enumerate(rest) if head is not None]
        spread = [np.linalg.norm(p - p.mean(axis=0)) for p in (joints[mapped], np.array([rest[i] for i in mapped]))]
        return (float(spread[1] / spread[0]) if min(spread) > 1e-9 else 1.0), False
    middle = float(np.median([found / length for length, found in pairs]))
    if torsos[0] is not None and torsos[1] is not None:
        pairs.append((torsos[0][1], torsos[1][1]))
    return middle, all(abs(found / (length * middle) - 1.0) < SAME_BODY for length, found in pairs)


def _heading(axes: np.ndarray, towards: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Turned about the vertical so that toes point where the armature's do; soles stay level."""
    up = axes[:, 1]
    flat = [vector - up * (vector @ up) for vector in (axes @ towards, wanted)]
    if min(np.linalg.norm(flat[0]) / np.linalg.norm(towards), np.linalg.norm(flat[1]) / np.linalg.norm(wanted)) < 0.3:
        return axes  # a foot that points down has no heading
    return swing(*flat) @ axes


def _turn_palm(
    mapping: RigMapping, names: list[str], joints: np.ndarray, heads: dict[str, np.ndarray], turns: list[np.ndarray]
) -> None:
    """Twists the hand that was turned last, and its forearm half as far, where the armature's palm rests otherwise."""
    model, place = mapping.model, {name: index for index, name in enumerate(names)}
    hand = len(turns) - 1
    side = model.part_of(names[hand])[0][-1]
    own = [model.parts.get(f"{finger}1.{side}") for finger in ("index", "pinky")]
    rigs = [mapping.rig.parts.get(f"{finger}1.{side}") for finger in ("index", "pinky")]
    arm = model.parts.get(f"lower_arm.{side}")
    if not arm or not all(rigs) or not all(each[0] in heads for each in rigs):
        return
    if all(own):
        across = joints[place[own[0][0]]] - joints[place[own[1][0]]]
    elif model.family is not None and model.family.name == "smpl":
        across = np.array([0.0, 0.0, 1.0])  # SMPL rests with the palms down, thumbs to the front
    else:
        return
    along = unit(turns[hand] @ (joints[hand] - joints[place[arm[0]]]))
    here, there = turns[hand] @ across, heads[rigs[0][0]] - heads[rigs[1][0]]
    here, there = here - along * (here @ along), there - along * (there @ along)
    angle = float(np.arctan2(np.cross(here, there) @ along, here @ there))
    if abs(angle) < _TWIST_FROM:
        return
    turns[hand] = about(along, angle) @ turns[hand]
    for bone in arm:
        turns[place[bone]] = about(along, angle / 2.0) @ turns[place[bone]]

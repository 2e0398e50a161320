"""A posed armature of any kind → rigid frames of a model's bones.

Rotations are carried; the figure keeps its own proportions.  What an animator has placed comes first:

* The figure hangs on its *hip joints*, not on the pelvis bone, whose joint every rig puts elsewhere: feet stand where
  the animator's do if the legs are as long.
* The upper body hangs on *neck and shoulder blades*: the model's spine, with however many bones, is bent so that they
  come to lie where the armature's are.
* Limbs point from joint to joint, so segments, twist bones and tweaks between two joints do not shift hands and feet;
  and they stretch and squash a little as the armature's do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .alignment import Alignment
from .mapping import RigMapping
from .rotations import nearest, swing

LARGEST_STRETCH = 0.1
"""How far a limb may follow the armature's in length, so that hands and feet stay, and how far the spine may be
stretched to reach the shoulders; a share of the length."""

NATURAL_SIZE = (0.6, 1.7)
"""A body so many times as large as the model's in Blender's world is another person; beyond, a doll or a giant."""


@dataclass(frozen=True)
class Skeleton:
    """The model's side: B bones.

    Attributes:
        names, parents: -1 for the root.
        joints: [B, 3] canonical rest joints, metres.
    """

    names: Sequence[str]
    parents: Sequence[int]
    joints: np.ndarray


@dataclass(frozen=True)
class Posed:
    """The armature's side in F frames: M bones by name, in Blender's world.

    Attributes:
        rotations: bone → [F, 3, 3] world from armature's rest axes.
        heads: bone → [F, 3].
        rest: bone → [3] head at rest in armature space.
        world_from_armature: [F, 4, 4] the armature object itself.
        size: metres of Blender's world in a unit of the armature.
    """

    rotations: dict[str, np.ndarray]
    heads: dict[str, np.ndarray]
    rest: dict[str, np.ndarray]
    world_from_armature: np.ndarray
    size: float


def natural_scale(alignment: Alignment, object_scale: float) -> float:
    """The figure's size against the model's: 1 for any grown person, the armature's for its scaled copies.

    Args:
        object_scale: of the armature object in the world.
    """
    size = alignment.unit * object_scale
    if abs(size - 1.0) < 0.02 or (not alignment.same_body and NATURAL_SIZE[0] <= size <= NATURAL_SIZE[1]):
        return 1.0
    return size


def retarget(
    skeleton: Skeleton, mapping: RigMapping, alignment: Alignment, posed: Posed, scale: float, *, legs_scale: bool
) -> np.ndarray:
    """Frames [F, B, 4, 4] of the model's bones in Blender's world divided by ``scale``, metres.

    Args:
        scale: the figure's size, see ``natural_scale``.
        legs_scale: shorten or lengthen the hips' path as the figure's legs are shorter or longer than the armature's.
    """
    rotations = _rotations(skeleton, mapping, alignment, posed)
    body = _Body(skeleton, mapping, alignment, posed, scale)
    joints, parents = skeleton.joints, skeleton.parents
    places: dict[int, np.ndarray] = {}
    anchor = body.first("hips") or 0
    thighs = body.pair("upper_leg")
    if thighs is not None:
        middle = body.middle(thighs)
        if legs_scale:
            middle = _scaled_path(body, thighs, middle)
        places[anchor] = middle - rotations[:, anchor] @ (joints[list(thighs)].mean(axis=0) - joints[anchor])
    elif body.is_mapped(anchor):
        places[anchor] = body.head(anchor)
    else:
        places[anchor] = posed.world_from_armature[:, :3, 3] / scale
    index = anchor
    while parents[index] >= 0:  # a root above the hips
        parent = parents[index]
        places[parent] = places[index] - rotations[:, parent] @ (joints[index] - joints[parent])
        index = parent

    def place(index: int) -> None:
        if index in places:
            return
        parent = parents[index]
        place(parent)
        if not body.is_mapped(index):
            rotations[:, index] = rotations[:, parent]
        if thighs is not None and index in thighs and parent == anchor:
            places[index] = _on_hip_line(body, thighs, index, places[anchor], rotations[:, anchor])
        else:
            offset = rotations[:, parent] @ (joints[index] - joints[parent])
            places[index] = places[parent] + offset * body.stretch(parent, index)

    spine = body.chain("spine")
    for index in spine:
        place(index)
    if spine and thighs is not None:
        _bend_spine(body, spine, thighs, places, rotations, anchor)
    for index in range(len(parents)):
        place(index)
    result = np.zeros((*rotations.shape[:2], 4, 4))
    result[..., :3, :3] = rotations
    result[..., :3, 3] = np.stack([places[index] for index in range(len(parents))], axis=1)
    result[..., 3, 3] = 1.0
    return result


def _rotations(skeleton: Skeleton, mapping: RigMapping, alignment: Alignment, posed: Posed) -> np.ndarray:
    """World from canonical [F, B, 3, 3], each bone by itself; those without a bone keep to their parents."""
    found: list[np.ndarray] = []
    names = list(skeleton.names)
    for index, name in enumerate(names):
        bones = mapping.bones[name]
        if not bones:
            parent = skeleton.parents[index]
            still = nearest(posed.world_from_armature[:, :3, :3]) @ alignment.axes
            found.append(found[parent] if parent >= 0 else still)
            continue
        turned = posed.rotations[bones[0]]
        if len(bones) > 1:
            turned = nearest(sum(posed.rotations[bone] for bone in bones) / len(bones))
        turned = turned @ alignment.turns[index]
        link = alignment.links[index]
        if link is not None and link.follows:
            towards = turned @ (skeleton.joints[link.end] - skeleton.joints[link.start])
            ends = [posed.heads[mapping.bones[names[each]][0]] for each in (link.start, link.end)]
            turned = swing(towards, ends[1] - ends[0]) @ turned
        found.append(turned)
    return np.stack(found, axis=1)


@dataclass(frozen=True)
class _Body:
    """Parts of the model's body as indices, with the armature's joints for them in the figure's metres."""

    skeleton: Skeleton
    mapping: RigMapping
    alignment: Alignment
    posed: Posed
    scale: float

    @property
    def unit(self) -> float:
        """Metres of the figure's space in a unit of the armature."""
        return self.posed.size / self.scale

    def chain(self, part: str) -> list[int]:
        return [list(self.skeleton.names).index(name) for name in self.mapping.model.parts.get(part, ())]

    def first(self, part: str) -> int | None:
        found = self.chain(part)
        return found[0] if found else None

    def is_mapped(self, index: int) -> bool:
        return bool(self.mapping.bones[self.skeleton.names[index]])

    def pair(self, part: str) -> tuple[int, int] | None:
        """Both sides' first bones, where both are mapped."""
        left, right = self.first(f"{part}.L"), self.first(f"{part}.R")
        return (left, right) if self.all_mapped(left, right) else None  # type: ignore[return-value]

    def all_mapped(self, *indices: int | None) -> bool:
        return all(index is not None and self.is_mapped(index) for index in indices)

    def _bone(self, index: int) -> str:
        return self.mapping.bones[self.skeleton.names[index]][0]

    def head(self, index: int) -> np.ndarray:
        """[F, 3] posed."""
        return self.posed.heads[self._bone(index)] / self.scale

    def stretch(self, parent: int, index: int) -> np.ndarray | float:
        """[F, 1] by how much the armature stretches a limb in each frame, between the joints of two model bones."""
        link, model = self.alignment.links[parent], self.mapping.model
        names = self.skeleton.names
        if link is None or (index != link.end and model.part_of(names[index])[0] != model.part_of(names[parent])[0]):
            return 1.0
        found = np.linalg.norm(self.head(link.end) - self.head(link.start), axis=-1, keepdims=True)
        rest = float(np.linalg.norm(np.diff(self.rest((link.start, link.end)), axis=0))) * self.unit
        return np.clip(found / rest, 1.0 - LARGEST_STRETCH, 1.0 + LARGEST_STRETCH)

    def middle(self, indices: Sequence[int]) -> np.ndarray:
        """[F, 3] mean of posed heads."""
        return sum(self.head(index) for index in indices) / len(indices)  # type: ignore[return-value]

    def rest(self, indices: Sequence[int]) -> np.ndarray:
        """[N, 3] rest heads in armature space."""
        return np.array([self.posed.rest[self._bone(index)] for index in indices])


def _scaled_path(body: _Body, thighs: tuple[int, int], middle: np.ndarray) -> np.ndarray:
    """The hips' path about the ground under the resting hips, as much longer or shorter as the figure's legs are."""
    legs = [[body.first(f"{part}.{side}") for part in ("upper_leg", "lower_leg", "foot")] for side in "LR"]
    legs = [leg for leg in legs if body.all_mapped(*leg)]
    if not legs:
        return middle
    own = np.mean([np.linalg.norm(np.diff(body.skeleton.joints[leg], axis=0), axis=1).sum() for leg in legs])
    rigs = np.mean([np.linalg.norm(np.diff(body.rest(leg), axis=0), axis=1).sum() for leg in legs])  # type: ignore[arg-type]
    ground = body.rest(thighs).mean(axis=0) - body.alignment.axes[:, 1] * rigs
    world = body.posed.world_from_armature
    ground = (world[:, :3, :3] @ ground + world[:, :3, 3]) / body.scale
    return ground + (middle - ground) * (own / (rigs * body.unit))


def _on_hip_line(
    body: _Body, thighs: tuple[int, int], index: int, pelvis: np.ndarray, rotation: np.ndarray
) -> np.ndarray:
    """A hip joint where the armature's is, which may turn in its pelvis; apart as the model's are at rest."""
    joints, anchor = body.skeleton.joints, body.first("hips") or 0
    middle = pelvis + rotation @ (joints[list(thighs)].mean(axis=0) - joints[anchor])
    found = float(np.linalg.norm(np.diff(body.rest(thighs), axis=0)))
    if found < 1e-9:
        return pelvis + rotation @ (joints[index] - joints[anchor])
    own = float(np.linalg.norm(joints[thighs[0]] - joints[thighs[1]]))
    return middle + (body.head(index) - body.middle(thighs)) * (own / (found * body.unit))


def _bend_spine(
    body: _Body,
    spine: list[int],
    thighs: tuple[int, int],
    places: dict[int, np.ndarray],
    rotations: np.ndarray,
    anchor: int,
) -> None:
    """Bends and, a little, stretches the spine so that neck and shoulder blades come where the armature's are; in
    place.

    The armature's line from hips to shoulders counts in the model's length; where it lies otherwise at rest, it is
    turned.
    """
    joints, parents, chest = body.skeleton.joints, body.skeleton.parents, spine[-1]
    found = [body.first(part) for part in ("neck", "collar.L", "collar.R", "upper_arm.L", "upper_arm.R")]
    hung = [each for each in found if each is not None and parents[each] == chest and body.is_mapped(each)]
    if not hung:
        return
    top, low = joints[hung].mean(axis=0), joints[list(thighs)].mean(axis=0)
    rest = body.rest(hung).mean(axis=0) - body.rest(thighs).mean(axis=0)
    torso, found_torso = float(np.linalg.norm(top - low)), float(np.linalg.norm(rest))
    if torso < 1e-6 or found_torso < 1e-9:
        return
    share = torso / found_torso
    otherwise = (top - low) - body.alignment.axes.T @ rest * share
    pelvis = places[anchor] + rotations[:, anchor] @ (low - joints[anchor])
    wanted = pelvis + (body.middle(hung) - body.middle(thighs)) * (share / body.unit)
    wanted = wanted + rotations[:, anchor] @ otherwise - rotations[:, chest] @ (top - joints[chest])
    start = places[spine[0]]
    turn = swing(places[chest] - start, wanted - start) if len(spine) > 1 else None
    for before, index in pairwise(spine):
        rotations[:, before] = turn @ rotations[:, before]
        places[index] = places[before] + np.einsum("fij,j->fi", rotations[:, before], joints[index] - joints[before])
    short = wanted - places[chest]
    length = np.maximum(np.linalg.norm(short, axis=-1, keepdims=True), 1e-12)
    short = short * np.minimum(1.0, LARGEST_STRETCH * torso / length)
    for position, index in enumerate(spine, start=1):
        places[index] = places[index] + short * (position / len(spine))

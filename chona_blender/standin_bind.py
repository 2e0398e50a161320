"""A stand-in in an armature's own rest pose, with the armature's bones for the model's.

The model's meshes rest in its T-pose.  The armature may rest in an A-pose, in other axes and another unit: where the
figure stands when the armature rests is known from the retargeting that bakes go through, so the mesh is posed there by
the model's own skinning.  Posing the armature from there moves it by the armature's bones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .errors import ChonaError
from .rig.driver import Driver
from .rig.sampling import Samples
from .rig.validation import STRETCH_LIMIT
from .standin_file import PartMesh


@dataclass(frozen=True)
class Binding:
    """What an armature modifier needs.

    Attributes:
        vertices: [V, 3] at rest in the armature's space.
        groups: bone of the armature → indices [K] of vertices and weights [K]; those of a vertex sum to one.
    """

    vertices: np.ndarray
    groups: Mapping[str, tuple[np.ndarray, np.ndarray]]


def bind(driver: Driver, part: PartMesh, *, to_figure: bool = False) -> Binding:
    """Poses a person's mesh as its armature rests.

    Args:
        to_figure: weights by the model's bones, for an armature of the figure's own (``standin_figure``); else by the
            bones of the user's.

    Raises:
        ChonaError: the armature's object is mirrored or sheared, or a bone that moves the figure deforms no meshes.
    """
    groups = model_groups(driver, part) if to_figure else bone_groups(driver, part)
    world = np.array(driver.armature.matrix_world, dtype=np.float64)
    frames, scale = rest_frames(driver, world)
    posed = scale * skin(frames, driver.skeleton.joints, part)
    inverse = np.linalg.inv(world)
    return Binding(posed @ inverse[:3, :3].T + inverse[:3, 3], groups)


def rest_frames(driver: Driver, world_from_rig: np.ndarray) -> tuple[np.ndarray, float]:
    """Frames [B, 4, 4] of the model's bones while the armature rests, and the figure's scale; see ``RigidPose``."""
    bones = np.broadcast_to(world_from_rig, (1, len(driver.bones), 4, 4))
    samples = Samples(np.zeros(1, np.int64), bones, np.empty((1, 0, 4, 4)), ((),), world_from_rig[None])
    pose = driver.pose(samples, (), limit=STRETCH_LIMIT, object_limit=None)
    return pose.world_from_bone[0], pose.scale


def skin(world_from_bone: np.ndarray, joints: np.ndarray, part: PartMesh) -> np.ndarray:
    """The model's own forward skinning, without its pose-dependent offset: [V, 3]."""
    rotations = world_from_bone[:, :3, :3]
    shifts = world_from_bone[:, :3, 3] - np.einsum("bij,bj->bi", rotations, joints)
    posed = np.zeros_like(part.vertices)
    for bones, weights in zip(part.bones.T, part.weights.T, strict=True):
        used = np.flatnonzero(bones >= 0)
        at = bones[used]
        moved = np.einsum("vij,vj->vi", rotations[at], part.vertices[used]) + shifts[at]
        posed[used] += weights[used, None] * moved
    return posed


def model_groups(driver: Driver, part: PartMesh) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Weights by the model's bones."""
    found = {}
    for index in np.unique(part.bones[part.bones >= 0]):
        weight = np.where(part.bones == index, part.weights, 0.0).sum(axis=1)
        held = np.flatnonzero(weight > 0.0)
        found[driver.skeleton.names[int(index)]] = held, weight[held]
    return found


def bone_groups(driver: Driver, part: PartMesh) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Weights by the armature's bones.

    Where a limb has several segments, each takes an equal share, as bakes take their mean; bones of the model without
    one hand theirs to their parents.

    Raises:
        ChonaError: a bone that deforms no meshes, by name.
    """
    names, parents = list(driver.skeleton.names), driver.skeleton.parents
    dense: dict[str, np.ndarray] = {}
    for index in np.unique(part.bones[part.bones >= 0]):
        weight = np.where(part.bones == index, part.weights, 0.0).sum(axis=1)
        at = int(index)
        while not driver.mapping.bones[names[at]] and parents[at] >= 0:
            at = parents[at]
        chain = _deforming(driver, names[at])
        for bone in chain:
            dense[bone] = dense.get(bone, 0.0) + weight / len(chain)
    found = {}
    for bone, weight in dense.items():
        held = np.flatnonzero(weight > 0.0)
        found[bone] = held, weight[held]
    return found


def _deforming(driver: Driver, name: str) -> list[str]:
    """Bones of the armature for a model's bone that armature modifiers heed.

    Where a control moves the figure, as it may be named like the model's bone, the nearest deforming bone of the same
    part of the body stands in for it.
    """
    chain = driver.mapping.bones[name]
    if not chain:
        raise ChonaError(f"Bone '{name}' of the model maps to nothing. Choose a bone for it under Rig, Bones")
    bones = driver.armature.data.bones
    kept = [bone for bone in chain if bones[bone].use_deform]
    if kept:
        return kept
    same = driver.mapping.rig.parts.get(driver.mapping.model.part_of(name)[0], ())
    others = [bone for bone in same if bones[bone].use_deform]
    if not others:
        raise ChonaError(
            f"bone '{chain[0]}' of armature '{driver.armature.name}', which moves '{name}', deforms no meshes; set "
            "Follow to Figure under Stand-In, switch on the bone's Deform, or choose another bone under Rig, Bones"
        )
    return [min(others, key=lambda bone: float(np.linalg.norm(driver.heads[bone] - driver.heads[chain[0]])))]

"""How one armature poses one person: which bones are sampled, and how their matrices become the model's frames.

An armature that is a copy of the model's skeleton, as ``Create Rig`` makes it, is taken as it is, each bone where its
head is.  Any other is retargeted (``retarget``): rotations are carried, so however far its limbs stretch does no harm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from bpy.types import Object

from .alignment import Alignment, align
from .mapping import RigMapping, map_rig
from .rest_pose import SCALED_COPY_ERROR, RestPose, fit_axes, model_rest_pose, rest_matrices
from .retarget import Posed, Skeleton, natural_scale, retarget
from .rigid import RigidPose, objects_pose, rigid_pose
from .sampling import Samples, check_armature
from .validation import figure_scale, project_rotations

ALIGNED_KEPT = 8
"""Rest poses whose alignment is kept: the live preview asks thirty times a second."""

_aligned: dict[tuple, Alignment] = {}


@dataclass(frozen=True)
class Driver:
    """An armature for a person.

    Attributes:
        mapping: the armature's bones for the model's.
        skeleton: the person's.
        bones: the bones to sample.
        rest: where the armature is a copy of the model's skeleton, its rest pose; else None.
        alignment: where it is not, how its rest pose lies against the model's.
        heads: rest head [3] of each bone in armature space.
        legs_scale: see ``retarget``.
    """

    armature: Object
    mapping: RigMapping
    skeleton: Skeleton
    bones: tuple[str, ...]
    rest: RestPose | None
    alignment: Alignment | None
    heads: dict[str, np.ndarray]
    legs_scale: bool

    @property
    def size(self) -> float:
        """Metres of Blender's world in a unit of the armature, by its object as it is now."""
        return float(np.cbrt(abs(np.linalg.det(np.array(self.armature.matrix_world)[:3, :3]))))

    def pose(
        self,
        samples: Samples,
        object_names: Sequence[str],
        *,
        limit: float,
        object_limit: float | None,
        stretched: bool = False,
    ) -> RigidPose:
        """The sampled frames as the model's, see ``rigid_pose``.

        Args:
            samples: of ``bones`` in their order.
            limit: largest stretch that is dropped of a copy of the model's skeleton.
            object_limit: the same for objects.
            stretched: drop any stretch of bones, for looking at what is wrong.

        Raises:
            ChonaError: not finite, zero scale, mirrored, or stretched past the limit, by name and frame.
        """
        names = list(self.skeleton.names)
        if self.rest is not None:
            chosen = None if stretched else limit
            return rigid_pose(samples, self.rest, names, object_names, limit=chosen, object_limit=object_limit)
        linear = samples.world_from_armature[..., :3, :3]
        size = figure_scale(linear) if np.isfinite(linear).all() else 1.0
        rotations, dropped = project_rotations(
            linear, size if size > 0 else 1.0, "Bone", names=self.bones, frames=samples.frames,
            limit=None,
        )  # fmt: skip
        posed = Posed(
            {bone: rotations[:, index] for index, bone in enumerate(self.bones)},
            {
                bone: (linear[:, index] @ self.heads[bone]) + samples.world_from_armature[:, index, :3, 3]
                for index, bone in enumerate(self.bones)
            },
            self.heads,
            samples.world_from_rig,
            size,
        )
        scale = natural_scale(self.alignment, size)  # type: ignore[arg-type]
        frames = retarget(self.skeleton, self.mapping, self.alignment, posed, scale, legs_scale=self.legs_scale)  # type: ignore[arg-type]
        placed, more = objects_pose(samples, object_names, scale, object_limit)
        return RigidPose(frames, placed, scale, (*dropped, *more))


def make_driver(
    armature: Object | None,
    names: Sequence[str],
    parents: Sequence[int],
    joints: np.ndarray,
    overrides: Mapping[str, str] | None = None,
    *,
    legs_scale: bool = False,
) -> Driver:
    """Maps and aligns an armature.

    Args:
        names, parents: the model's B bones.
        joints: [B, 3] the person's rest joints, canonical space, metres.
        overrides: the user's choice, model bone → armature bone or ``mapping.FOLLOW``.

    Raises:
        ChonaError: no armature, one that cannot be sampled, or a bone that maps to nothing.
    """
    armature = check_armature(armature)
    mapping = map_rig(armature, names, overrides).check()
    skeleton = Skeleton(tuple(names), tuple(parents), joints)
    every = [bone.name for bone in armature.data.bones]
    heads = dict(zip(every, rest_matrices(armature, every)[:, :3, 3], strict=True))
    first = [bones[0] for bones in mapping.bones.values() if bones]
    if all(len(bones) == 1 for bones in mapping.bones.values()) and is_copy(
        joints, np.array([heads[b] for b in first])
    ):
        rest = model_rest_pose(armature, first, joints)
        return Driver(armature, mapping, skeleton, tuple(first), rest, None, heads, legs_scale)
    bones = tuple(dict.fromkeys(bone for chain in mapping.bones.values() for bone in chain))
    lying = (tuple(heads), np.array(list(heads.values())).tobytes())
    at_rest = (tuple(mapping.bones.items()), tuple(parents), joints.tobytes(), *lying)
    if at_rest not in _aligned:
        while len(_aligned) >= ALIGNED_KEPT:
            _aligned.pop(next(iter(_aligned)))
        _aligned[at_rest] = align(mapping, parents, joints, heads)
    return Driver(armature, mapping, skeleton, bones, None, _aligned[at_rest], heads, legs_scale)


def is_copy(joints: np.ndarray, heads: np.ndarray) -> bool:
    """Whether heads [B, 3] are joints [B, 3] but for their unit, axes and origin."""
    joints, heads = joints - joints.mean(axis=0), heads - heads.mean(axis=0)
    if np.linalg.norm(joints) < 1e-9 or np.linalg.norm(heads) < 1e-9:
        return True  # one bone, or none spread: nothing to compare, ``model_rest_pose`` decides
    return fit_axes(joints, heads)[2] <= SCALED_COPY_ERROR

"""Skeletons: names, parents and rest joints of body bones, and the rigid frames (pseudo bones) of objects.

A *body bone* is identified with its joint: its frame sits at the joint and, in canonical space (T-pose, y up, metres,
facing +z), its axes are parallel to the world's.  So the canonical frame of bone ``j`` is a pure translation to its
rest joint, and the paper's transform is ``T_j = world_from_bone_j @ translation(-rest_joint_j)``.

An *object* is one pseudo bone: a rigid frame with an extent and no length (an empty: head = tail).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SMPL_NAMES = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
SMPL_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)

LEAF_LENGTH_SHARE = 0.5
"""A bone without children is given this share of its parent bone's length."""


MOST_BONES = 2048
"""Of a body; every one is a column of all skinning weights."""


class SkeletonError(ValueError):
    """A skeleton that cannot be animated: cycles, unknown parents, doubled names."""


@dataclass(frozen=True)
class Skeleton:
    """A tree of body bones, parents before children.

    Attributes:
        names: B bone names, unique.
        parents: B indices of parents; -1 for the root, which comes first.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.names) != len(self.parents) or not self.names:
            raise SkeletonError(
                f"a skeleton needs as many parents as names and at least one bone, got {len(self.names)} names and "
                f"{len(self.parents)} parents"
            )
        if len(self.names) > MOST_BONES:
            raise SkeletonError(f"a skeleton has {len(self.names)} bones, expected at most {MOST_BONES}")
        doubled = sorted({name for name in self.names if self.names.count(name) > 1})
        if doubled:
            raise SkeletonError(f"bone names must be unique, these occur twice: {', '.join(doubled)}")
        if self.parents[0] != -1:
            raise SkeletonError(f"the first bone must be the root (parent -1), got parent {self.parents[0]}")
        for index, parent in enumerate(self.parents[1:], start=1):
            if not 0 <= parent < index:
                raise SkeletonError(
                    f"bone '{self.names[index]}' has parent {parent}: parents come before their children and only the "
                    "first bone is a root"
                )

    def __len__(self) -> int:
        return len(self.names)

    def bone_tails(self, rest_joints: np.ndarray) -> np.ndarray:
        """Tail of every bone in canonical space: the mean of its children's joints.

        Leaves continue their parent's direction by ``LEAF_LENGTH_SHARE`` of its length; a skeleton of one bone has
        length zero.

        Args:
            rest_joints: [B, 3] canonical joints, metres.

        Returns:
            [B, 3] tails, metres.
        """
        tails = np.array(rest_joints, dtype=np.float64)
        for index in range(len(self)):
            children = [child for child, parent in enumerate(self.parents) if parent == index]
            if children:
                tails[index] = rest_joints[children].mean(axis=0)
        for index, parent in enumerate(self.parents):
            if parent >= 0 and index not in self.parents:
                tails[index] = rest_joints[index] + LEAF_LENGTH_SHARE * (rest_joints[index] - rest_joints[parent])
        return tails


SMPL = Skeleton(SMPL_NAMES, SMPL_PARENTS)


def translation(offset: np.ndarray) -> np.ndarray:
    """Homogeneous translations [..., 4, 4] by ``offset`` [..., 3]."""
    offset = np.asarray(offset, dtype=np.float64)
    matrix = np.zeros((*offset.shape[:-1], 4, 4))
    matrix[..., range(4), range(4)] = 1.0
    matrix[..., :3, 3] = offset
    return matrix


def canonical_to_world(world_from_bone: np.ndarray, rest_joints: np.ndarray) -> np.ndarray:
    """The paper's T_j: the rigid map from canonical space to the posed world for every bone.

    Args:
        world_from_bone: [..., B, 4, 4] posed bone frames.
        rest_joints: [B, 3] canonical joints, metres.

    Returns:
        [..., B, 4, 4].
    """
    return np.asarray(world_from_bone, dtype=np.float64) @ translation(-np.asarray(rest_joints, dtype=np.float64))


def forward_kinematics(
    skeleton: Skeleton, rest_joints: np.ndarray, local_rotations: np.ndarray, root_translation: np.ndarray
) -> np.ndarray:
    """Posed bone frames from rotations relative to the parent.

    Args:
        rest_joints: [B, 3] canonical joints, metres.
        local_rotations: [..., B, 3, 3] rotation of each bone relative to its parent.
        root_translation: [..., 3] added to the root's rest joint, metres.

    Returns:
        [..., B, 4, 4] ``world_from_bone``.
    """
    batch = local_rotations.shape[:-3]
    world_from_bone = np.zeros((*batch, len(skeleton), 4, 4))
    for index, parent in enumerate(skeleton.parents):
        local = np.zeros((*batch, 4, 4))
        local[..., 3, 3] = 1.0
        local[..., :3, :3] = local_rotations[..., index, :, :]
        if parent < 0:
            local[..., :3, 3] = rest_joints[index] + root_translation
            world_from_bone[..., index, :, :] = local
        else:
            local[..., :3, 3] = rest_joints[index] - rest_joints[parent]
            world_from_bone[..., index, :, :] = world_from_bone[..., parent, :, :] @ local
    return world_from_bone

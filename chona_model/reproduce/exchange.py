"""One person's performance given to another, and one object's to another: what the paper shows of novel identities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from chona_model.data.dataset import Person, Pose
from chona_model.skeleton import Skeleton, forward_kinematics


def performed_by(pose: Pose, skeleton: Skeleton, person: Person) -> Pose:
    """The pose with the joint rotations that it has and another person's proportions; the root stays where it is."""
    rotations = pose.world_from_bone[:, :3, :3]
    parents = np.array(skeleton.parents)
    local = np.where(
        (parents >= 0)[:, None, None], np.swapaxes(rotations[np.maximum(parents, 0)], -1, -2) @ rotations, rotations
    )
    bones = forward_kinematics(skeleton, person.rest_joints, local, np.zeros(3))
    bones[:, :3, 3] += pose.world_from_bone[0, :3, 3] - bones[0, :3, 3]
    return replace(pose, person=person.name, world_from_bone=bones)


def with_objects(pose: Pose, names: tuple[str, ...]) -> Pose:
    """The pose with other objects in the places of its own."""
    if len(names) != len(pose.objects):
        raise ValueError(f"the pose has {len(pose.objects)} objects, {len(names)} names were given for them")
    return replace(pose, objects=names)

"""What a model file says of its training poses, against brute force and scipy."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chona_model.skeleton import SMPL, forward_kinematics
from chona_model.train.pose_summary import MOST_NUMBERS, local_rotations, rotation_vectors, summarise


def performance(count: int, amount: float = 0.4, seed: int = 0) -> np.ndarray:
    """[P, 24, 4, 4] random poses."""
    random = np.random.default_rng(seed)
    joints = random.normal(0.0, 0.3, (24, 3))
    turns = Rotation.from_rotvec(random.normal(0.0, amount, (count * 24, 3))).as_matrix().reshape(count, 24, 3, 3)
    return np.stack([forward_kinematics(SMPL, joints, each, np.zeros(3)) for each in turns])


def test_every_training_pose_is_within_the_radius_of_a_kept_one() -> None:
    poses = performance(300)
    summary = summarise(SMPL.names, SMPL.parents, poses)
    local = local_rotations(SMPL.parents, poses)[:, 1:]
    kept = Rotation.from_rotvec(np.reshape(summary["poses"], (-1, 3)))
    kept = kept.as_matrix().reshape(-1, 23, 3, 3)
    assert summary["count"] == 300 and 20 <= len(kept) <= 64
    steps = np.einsum("pjab,kjac->pkjbc", local, kept)
    angles = Rotation.from_matrix(steps.reshape(-1, 3, 3)).magnitude().reshape(300, len(kept), 23)
    away = np.sqrt((angles**2).mean(-1)).min(axis=1)
    assert away.max() == pytest.approx(summary["radius"], abs=2e-3)
    np.testing.assert_allclose(angles.min(axis=1).max(axis=0), summary["spacing"], atol=3e-3)
    assert (away < 2e-3).sum() >= len(kept), "kept poses are poses of the training"


def test_kept_poses_are_spread() -> None:
    """Two poses repeated a hundred times with a little noise are two kept poses, not sixty-four."""
    two = performance(2, amount=0.8)
    summary = summarise(
        SMPL.names, SMPL.parents, np.concatenate([np.repeat(two[:1], 100, 0), np.repeat(two[1:], 100, 0)])
    )
    assert len(summary["poses"]) == 2 and summary["radius"] < 1e-6


def test_small_enough_for_a_header() -> None:
    text = json.dumps(summarise(SMPL.names, SMPL.parents, performance(400)))
    assert len(text) < 45_000
    names = [f"bone{index}" for index in range(120)]
    parents = [-1, *range(119)]
    wide = np.tile(np.eye(4), (80, 120, 1, 1))
    turns = Rotation.from_rotvec(np.random.default_rng(1).normal(0, 0.5, (9600, 3))).as_matrix()
    wide[..., :3, :3] = turns.reshape(80, 120, 3, 3)
    assert np.size(summarise(names, parents, wide)["poses"]) <= MOST_NUMBERS


def test_the_root_does_not_count() -> None:
    """Walking elsewhere and turning round is no other pose."""
    one = performance(1)[0]
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = Rotation.from_euler("y", 2.0).as_matrix(), (3.0, 0.0, -2.0)
    summary = summarise(SMPL.names, SMPL.parents, np.stack([one, moved @ one]))
    assert len(summary["poses"]) == 1 and "pelvis" not in summary["bones"]


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-3, 1.0, np.pi - 1e-6, np.pi])
def test_rotation_vectors_at_every_angle(angle: float) -> None:
    axes = np.random.default_rng(2).normal(size=(50, 3))
    axes = np.concatenate([axes, np.eye(3), -np.eye(3)])
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    turns = Rotation.from_rotvec(axes * angle).as_matrix()
    again = Rotation.from_rotvec(rotation_vectors(turns)).as_matrix()
    np.testing.assert_allclose(again, turns, atol=1e-9)


def test_one_bone_has_no_joints() -> None:
    summary = summarise(["root"], [-1], np.tile(np.eye(4), (3, 1, 1, 1)))
    assert summary["bones"] == [] and summary["radius"] == 0.0 and summary["spacing"] == []

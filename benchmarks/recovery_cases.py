"""Canonical points whose posed places are known by construction: the targets that ``recovery`` searches roots of.

Skinning weights are softmax(−distance to the bone / 3 cm) for every method, so that none has an easier map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from chona_model.data.dataset import Dataset
from chona_model.figure import PoseBatch, Rig, make_figure, to_pose_batch
from chona_model.skeleton import SMPL, Skeleton, forward_kinematics

FALLOFF = 0.03
"""Of skinning weights with the distance to a bone, metres."""

AROUND = 0.01
"""How far points lie from the body's surface, or from the bones where there is none, metres."""

ANGLES = (0.25, 0.5, 1.0, 1.5, 2.2, 3.1)
"""Random joint angles go up to these, radians: from mild to absurd."""

SIZE = 2.5
"""Of the figure, metres: tolerances are shares of it."""

REST_JOINTS = np.array(
    [
        [0.0, 0.0, 0.0], [0.06, -0.09, 0.0], [-0.06, -0.09, 0.0], [0.0, 0.12, -0.02], [0.10, -0.47, 0.0],
        [-0.10, -0.47, 0.0], [0.0, 0.25, 0.0], [0.09, -0.87, -0.04], [-0.09, -0.87, -0.04], [0.0, 0.31, 0.02],
        [0.12, -0.93, 0.08], [-0.12, -0.93, 0.08], [0.0, 0.52, -0.02], [0.08, 0.43, 0.0], [-0.08, 0.43, 0.0],
        [0.0, 0.60, 0.04], [0.17, 0.46, -0.01], [-0.17, 0.46, -0.01], [0.43, 0.45, -0.03], [-0.43, 0.45, -0.03],
        [0.68, 0.46, -0.03], [-0.68, 0.46, -0.03], [0.76, 0.45, -0.04], [-0.76, 0.45, -0.04],
    ]
)  # fmt: skip
"""A body of SMPL's joints, 1.6 m from head to foot, metres: who is posed where no capture is at hand."""


@dataclass(frozen=True)
class Body:
    """Who is posed: rest joints [B, 3] of a skeleton, and [V, 3] vertices of the surface or None, metres."""

    skeleton: Skeleton
    joints: np.ndarray
    vertices: np.ndarray | None


PLAIN = Body(SMPL, REST_JOINTS, None)


def distance_weights(x: Tensor, heads: Tensor, tails: Tensor) -> tuple[Tensor, Tensor]:
    """softmax(−distance / ``FALLOFF``) [M, B] of points [M, 3], and its slopes [M, B, 3]."""
    along = tails - heads
    inverse = along / along.square().sum(dim=-1, keepdim=True)
    share = (x @ inverse.T - (heads * inverse).sum(dim=-1)).clamp(0, 1)
    away = x[:, None] - torch.addcmul(heads, share[..., None], along)
    distance = away.square().sum(dim=-1).sqrt().clamp(min=1e-12)
    weights = torch.softmax(-distance / FALLOFF, dim=-1)
    slopes = away * (weights / (-FALLOFF * distance))[..., None]
    return weights, torch.addcmul(slopes, weights[..., None], slopes.sum(dim=1, keepdim=True), value=-1.0)


@dataclass(frozen=True)
class Case:
    """M known roots in P poses of one body.

    Attributes:
        body: who; poses: as tensors; x: [M, 3] canonical points; targets: [M, 3] where they are posed; index: [M].
    """

    body: Body
    poses: PoseBatch
    x: Tensor
    targets: Tensor
    index: Tensor

    def warp(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """The forward map and its Jacobian at x [A, 3] in the poses of targets ``rows`` [A]."""
        weights, slopes = distance_weights(x, self.poses.heads[0], self.poses.tails[0])
        matrices = self.poses.transforms[:, : len(self.body.joints), :3].flatten(2).index_select(0, self.index[rows])
        # The blended matrix and its three slopes in one product; then each times [x; 1].
        blended = (torch.cat([weights[:, :, None], slopes], dim=2).transpose(1, 2) @ matrices).unflatten(2, (3, 4))
        moved = (blended[..., :3] * x[:, None, None]).sum(dim=-1) + blended[..., 3]
        return moved[:, 0], blended[:, 0, :, :3] + moved[:, 1:].transpose(1, 2)

    def to(self, dtype: torch.dtype) -> Case:
        """The same in another precision; targets are posed in float64 and rounded once."""
        poses = PoseBatch(**{
            name: value.to(dtype) if value.is_floating_point() else value
            for name, value in vars(self.poses).items()
        })  # fmt: skip
        return Case(self.body, poses, self.x.to(dtype), self.targets.to(dtype), self.index)


def body_points(body: Body, count: int, generator: np.random.Generator) -> np.ndarray:
    """[count, 3] canonical points within ``AROUND`` of the surface, or of the bones."""
    away = generator.normal(size=(count, 3))
    away *= AROUND * generator.random((count, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    if body.vertices is not None:
        return body.vertices[generator.integers(len(body.vertices), size=count)] + away
    bone, tails = generator.integers(len(body.joints), size=count), body.skeleton.bone_tails(body.joints)
    return body.joints[bone] + generator.random((count, 1)) * (tails[bone] - body.joints[bone]) + away


def make_case(body: Body, world_from_bone: Sequence[np.ndarray], points: int, seed: int) -> Case:
    """``points`` known roots in each of the poses [B, 4, 4], float64."""
    rig = Rig(body.skeleton, body.joints, 1.0)
    figures = [make_figure(rig, pose, np.zeros((0, 4, 4)), 0) for pose in world_from_bone]
    count = len(figures)
    poses = to_pose_batch(figures, [rig] * count, [0] * count, [[]] * count, torch.float64)
    x = torch.tensor(body_points(body, count * points, np.random.default_rng(seed)))
    index = torch.arange(count).repeat_interleave(points)
    case = Case(body, poses, x, x, index)
    rows = torch.arange(len(x)).split(8192)
    return Case(body, poses, x, torch.cat([case.warp(x[part], part)[0] for part in rows]), index)


def random_poses(body: Body, angle: float, count: int, seed: int) -> list[np.ndarray]:
    """Poses whose joints turn by up to ``angle`` radians about random axes."""
    generator = np.random.default_rng(seed)
    turns = generator.normal(size=(count, len(body.joints), 3))
    turns *= generator.uniform(0, angle, (count, len(body.joints), 1)) / np.linalg.norm(turns, axis=-1, keepdims=True)
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(*turns.shape, 3)
    return list(forward_kinematics(body.skeleton, body.joints, local, np.zeros((count, 3))))


def captured(dataset: Dataset) -> tuple[Body, list[np.ndarray]]:
    """The first person of a capture, and every pose it has there."""
    name, person = next(iter(dataset.persons.items()))
    vertices = None if person.surface is None else person.surface.vertices
    poses = {(v.sequence, v.frame): v.pose.world_from_bone for v in dataset.views if v.pose.person == name}
    return Body(dataset.skeleton, person.rest_joints, vertices), list(poses.values())

"""Skinning cached in voxels (Fast-SNARF's idea): learned weights on the nodes of a canonical grid, blended once a pose.

Between nodes weights are interpolated trilinearly.  Because blending is linear in the weights, interpolating the
blended matrices of a pose is the same function, so caching them per pose costs no accuracy.

The pose-conditioned offset F_Δ lives on the same nodes as a low-rank sum ``Σ_k c_k(P) D_k(x)`` and goes into the
blended matrices' last column: it costs nothing a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from torch import Tensor, nn

from chona_model.data.dataset import SkinnedSurface
from chona_model.field.present import linear_of_present
from chona_model.skeleton import Skeleton

LOGIT_FLOOR = 1e-4
"""Initial weights below this start here: softmax can still raise them."""

NEIGHBOURS = 6
"""Surface vertices whose weights a node's initial weights are averaged from."""

BONE_SOFTNESS = 0.03
"""Where no surface is known, initial weights fall off with distance to the bones over this length, metres."""


REST = 5e-7
"""A bone is at rest where no number of its transform is farther than this from the identity's: what rounding in float32
leaves of it, which is what rigs are posed in.  A point 2 m from the root is moved by less than 2 µm."""


@dataclass(frozen=True)
class NodeGrid:
    """A canonical grid whose far corners share the nearest active node.

    Attributes:
        origin: [3] metres; cell: metres; dims: [3] corners along each axis (x fastest in ``nodes``).
        nodes: [dims.prod()] int32 index of each corner's node.
        points: [M, 3] float32 canonical positions of the nodes, metres.
    """

    origin: np.ndarray
    cell: float
    dims: np.ndarray
    nodes: np.ndarray
    points: np.ndarray


def distance_to_bones(points: np.ndarray, heads: np.ndarray, tails: np.ndarray) -> np.ndarray:
    """Distances [M, B] from points [M, 3] to bone segments; zero-length bones are points. Metres."""
    along = tails - heads
    square = (along**2).sum(-1)
    safe = np.where(square > 0, square, 1.0)
    share = np.clip(np.einsum("mbk,bk->mb", points[:, None] - heads, along) / safe, 0.0, 1.0)
    share = np.where(square > 0, share, 0.0)
    return np.linalg.norm(points[:, None] - heads - share[..., None] * along, axis=-1)


def make_node_grid(
    lower: np.ndarray, upper: np.ndarray, cell: float, heads: np.ndarray, tails: np.ndarray, reach: float,
    surface: SkinnedSurface | None,
) -> NodeGrid:  # fmt: skip
    """Nodes within ``reach`` metres of the bones or of the surface are active."""
    dims = np.ceil((upper - lower) / cell).astype(np.int64) + 1
    axes = [lower[k] + cell * np.arange(dims[k]) for k in range(3)]
    z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    corners = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    near = np.concatenate([distance_to_bones(part, heads, tails).min(axis=1) for part in np.array_split(corners, 64)])
    active = near < reach
    if surface is not None:
        active |= cKDTree(surface.vertices).query(corners, distance_upper_bound=0.5 * reach)[0] < 0.5 * reach
    shape = (dims[2], dims[1], dims[0])
    number = np.cumsum(active) - 1
    nearest = distance_transform_edt(~active.reshape(shape), return_distances=False, return_indices=True)
    flat = np.ravel_multi_index(tuple(nearest.reshape(3, -1)), shape)
    return NodeGrid(
        np.asarray(lower, dtype=np.float64),
        cell,
        dims,
        number[flat].astype(np.int32),
        corners[active].astype(np.float32),
    )


def initial_weights(
    points: np.ndarray, heads: np.ndarray, tails: np.ndarray, surface: SkinnedSurface | None
) -> np.ndarray:
    """Skinning weights [M, B] to start from: the body model's where there is one, else from distances to bones."""
    if surface is None:
        closeness = -distance_to_bones(points, heads, tails) / BONE_SOFTNESS
        weights = np.exp(closeness - closeness.max(axis=1, keepdims=True))
        return weights / weights.sum(axis=1, keepdims=True)
    distance, index = cKDTree(surface.vertices).query(points, k=NEIGHBOURS)
    share = 1.0 / np.maximum(distance, 1e-3)
    weights = np.einsum("mk,mkb->mb", share / share.sum(axis=1, keepdims=True), surface.weights[index])
    return weights / weights.sum(axis=1, keepdims=True)


class SkinningVolume(nn.Module):
    """Learned skinning weights and offset of one person.

    Args:
        grid: where the nodes are.
        bones: B.
        pose_code: length of the pose code that the offset is conditioned on.
        offset_rank: K, shapes in the offset's basis; 0 for no offset.
    """

    def __init__(self, grid: NodeGrid, bones: int, pose_code: int, offset_rank: int) -> None:
        super().__init__()
        self.grid = grid
        count = len(grid.points)
        self.logits = nn.Parameter(torch.zeros(count, bones))
        self.rendering_weights: Tensor | None = None
        self._blended = 0
        self._some: tuple[Tensor, Tensor, Tensor] | None = None
        self.offset_rank = offset_rank
        if offset_rank:
            self.offset_shapes = nn.Parameter(torch.zeros(count, offset_rank, 3))
            self.offset_mix = nn.Sequential(nn.Linear(pose_code, 32), nn.ReLU(), nn.Linear(32, offset_rank), nn.Tanh())

    def initialise(self, weights: np.ndarray) -> None:
        """Starts from skinning weights [M, B]."""
        with torch.no_grad():
            self.logits.copy_(torch.as_tensor(np.log(np.maximum(weights, LOGIT_FLOOR)), dtype=self.logits.dtype))

    def weights(self) -> Tensor:
        """[M, B] softmax of the logits; rows sum to one."""
        return self.logits.softmax(dim=1)

    def offset(self, pose_codes: Tensor) -> Tensor | None:
        """[P, M, 3] metres, or None for a volume without offset."""
        if not self.offset_rank:
            return None
        into, *rest = self.offset_mix
        assert isinstance(into, nn.Linear)
        mix = linear_of_present(into, pose_codes)
        for layer in rest:
            mix = layer(mix)
        return torch.einsum("pk,mkc->pmc", mix, self.offset_shapes)

    def blend(self, transforms: Tensor, pose_codes: Tensor | None) -> Tensor:
        """The paper's (Σ_j w_j T_j) with F_Δ in the last column, rows padded to a cache line: [P, M, 16].

        Args:
            transforms: [P, B, 4, 4] canonical to root space.
            pose_codes: [P, C], or None to leave the offset out.
        """
        poses, bones = transforms.shape[:2]
        flat = transforms.reshape(poses, bones, 16).permute(1, 0, 2).reshape(bones, poses * 16)
        matrices = (self.weights() @ flat).reshape(-1, poses, 16).permute(1, 0, 2).contiguous()
        offset = None if pose_codes is None else self.offset(pose_codes)
        if offset is not None:
            columns = torch.nn.functional.pad(offset[..., None], (3, 0, 0, 1))
            matrices = matrices + columns.reshape(poses, -1, 16)
        return matrices

    @property
    def blended_bones(self) -> int:
        """How many bones the last pose for rendering blended: those that were not at rest."""
        return self._blended

    def _weights_of(self, bones: Tensor) -> Tensor:
        """[M, K + 1] weights of K bones and ones; kept for as long as the same bones are asked for."""
        if self.rendering_weights is None:
            self.rendering_weights = self.weights().detach()
        if self._some is None or self._some[0] is not self.rendering_weights or not torch.equal(self._some[1], bones):
            chosen = torch.nn.functional.pad(self.rendering_weights[:, bones], (0, 1), value=1.0)
            self._some = self.rendering_weights, bones, chosen
        return self._some[2]

    def blend_padded(self, transforms: Tensor, pose_codes: Tensor | None) -> Tensor:
        """``blend`` of one pose for rendering: [M, 16]; no gradients. Bones at rest are folded into the identity.

        Args:
            transforms: [B, 4, 4] canonical to root space.
            pose_codes: [1, C], or None to leave the offset out.
        """
        away, moving = moving_bones(transforms)
        still = torch.eye(4, dtype=away.dtype, device=away.device).reshape(1, 16)
        self._blended = len(moving)
        if len(moving) == 0:
            matrices = still.repeat(len(self.logits), 1)
        else:
            # Weights sum to one: Σ w T = I + Σ w (T − I), where a bone at rest adds nothing.
            matrices = self._weights_of(moving) @ torch.cat([away[moving], still])
        offset = None if pose_codes is None else self.offset(pose_codes)
        if offset is not None:
            matrices[:, 3:12:4] += offset[0]
        return matrices


def moving_bones(transforms: Tensor) -> tuple[Tensor, Tensor]:
    """What transforms [B, 4, 4] of bones, canonical to root space, are beyond the identity.

    Returns:
        [B, 16], and the indices [K] int64 of the bones that are not at rest.
    """
    away = (transforms - torch.eye(4, dtype=transforms.dtype, device=transforms.device)).reshape(-1, 16)
    return away, (away.abs().amax(dim=1) > REST).nonzero()[:, 0]


def bone_nodes(grid: NodeGrid, skeleton: Skeleton, rest_joints: np.ndarray, per_bone: int = 5) -> tuple[Tensor, Tensor]:
    """Nodes nearest to points on the bones and the bone each should follow alone (the paper's L_w).

    Returns:
        node indices [K] and bone indices [K], int64.
    """
    tails = skeleton.bone_tails(rest_joints)
    share = (np.arange(per_bone) + 0.5) / per_bone
    points = rest_joints[:, None] + share[None, :, None] * (tails - rest_joints)[:, None]
    nodes = cKDTree(grid.points).query(points.reshape(-1, 3))[1]
    bones = np.repeat(np.arange(len(skeleton)), per_bone)
    return torch.as_tensor(nodes), torch.as_tensor(bones)

"""Inverse skinning in a voxel volume of blended matrices, plain torch: Newton, then one implicit-function step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import embedding

from chona_model.kernels.reference.encode import corner_offsets

if TYPE_CHECKING:
    from chona_model.kernels.warp import NewtonLimits, VolumeIndex

INSIDE = 1e-3
"""Points outside a volume are moved this share of a cell inside its border before interpolation."""

SMALLEST_STEP_DETERMINANT = 0.05
"""Newton steps divide by no determinant closer to 0: blended rotations have determinants near 1."""


def invert(
    matrices: Tensor,
    posed: Tensor,
    starts: Tensor,
    pose: Tensor,
    index: VolumeIndex,
    limits: NewtonLimits,
    min_determinant: float,
) -> tuple[Tensor, Tensor]:
    """Canonical points of root-space points, from one start each; the best iterate counts.

    Args:
        matrices: [rows, 12] blended matrices; they get gradients by the implicit function theorem.
        posed, starts: [M, 3] metres.
        pose: [M] integer.
        index: where every pose finds its matrices.
        limits: settings of Newton's method.
        min_determinant: roots whose Jacobian is closer to singular give no gradient.

    Returns:
        roots [M, 3] and residuals [M] (no gradient), metres.
    """
    volume = _Volume(index, pose, posed.dtype)
    with torch.no_grad():
        roots, residuals = _newton(volume, matrices, posed, starts, limits)
    if not (torch.is_grad_enabled() and matrices.requires_grad):
        return roots, residuals
    # f(x(A), A) = posed for every A, hence dx = −J⁻¹ df at fixed x: a Newton step of value 0, but not of gradient 0.
    value, jacobian = volume.warp(roots, matrices)
    adjugate, determinant = _adjugate(jacobian.detach())
    regular = determinant.abs() >= min_determinant
    inverse = torch.where(regular[:, None, None], adjugate, 0.0) / torch.where(regular, determinant, 1.0)[:, None, None]
    return roots - (inverse * (value - value.detach())[:, None]).sum(dim=-1), residuals


def _newton(
    volume: _Volume, matrices: Tensor, posed: Tensor, starts: Tensor, limits: NewtonLimits
) -> tuple[Tensor, Tensor]:
    x, roots = starts, starts
    best = posed.new_full((len(posed),), 1e30)
    active = torch.ones_like(best, dtype=torch.bool)
    for step in range(limits.steps + 1):
        value, jacobian = volume.warp(x, matrices)
        offset = value - posed
        residual = offset.square().sum(dim=-1).sqrt()
        better = active & (residual < best)
        roots = torch.where(better[:, None], x, roots)
        best = torch.where(better, residual, best)
        active = active & ~(residual < limits.tolerance)
        if step == limits.steps:
            break
        adjugate, determinant = _adjugate(jacobian)
        sign = torch.where(determinant >= 0, 1.0, -1.0).to(determinant.dtype)
        determinant = sign * determinant.abs().clamp(min=SMALLEST_STEP_DETERMINANT)
        move = (adjugate * offset[:, None]).sum(dim=-1) / determinant[:, None]
        length = move.square().sum(dim=-1, keepdim=True).sqrt()
        move = torch.where(length > limits.max_step, move * (limits.max_step / length), move)
        x = torch.where(active[:, None], x - move, x)
    return roots, best


def blended_rotations(matrices: Tensor, points: Tensor, pose: Tensor, index: VolumeIndex) -> Tensor:
    """Linear parts [M, 3, 3] of the matrices blended at canonical points [M, 3] of poses [M]."""
    return _Volume(index, pose, points.dtype).blend(points, matrices)[0]


def warp(matrices: Tensor, points: Tensor, pose: Tensor, index: VolumeIndex) -> tuple[Tensor, Tensor]:
    """Posed points [M, 3] of canonical ones [M, 3] of poses [M], and the map's Jacobians there [M, 3, 3]."""
    return _Volume(index, pose, points.dtype).warp(points, matrices)


class _Volume:
    """What every one of M points needs to interpolate in its pose's volume."""

    def __init__(self, index: VolumeIndex, pose: Tensor, dtype: torch.dtype) -> None:
        def per_point(array: np.ndarray | Tensor) -> Tensor:
            return torch.as_tensor(array, device=pose.device)[pose.long()]

        self.nodes = torch.as_tensor(index.nodes, device=pose.device)
        self.first_node, self.first_row = per_point(index.first_node), per_point(index.first_row)
        self.dims = per_point(index.dims)
        self.origins = per_point(index.origins).to(dtype)
        self.inverse_cell = float(np.float32(index.inverse_cell))
        self.offsets = corner_offsets(pose.device)

    def blend(self, points: Tensor, matrices: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """A(x) [M, 3, 3]; and of the corners around x: f of their own matrices [M, 8, 3], weights [M, 8] and the
        weights' slopes [M, 8, 3]."""
        inside = (points - self.origins) * self.inverse_cell
        inside = torch.minimum(inside.clamp(min=0.0), (self.dims - 1).to(points.dtype) - INSIDE)
        lower = torch.minimum(inside.long().clamp(min=0), self.dims - 2)  # whatever a conversion makes of a NaN
        share = (inside - lower)[:, None]
        x, y, z = (lower[:, None] + self.offsets).unbind(dim=-1)
        nx, ny = self.dims[:, :1], self.dims[:, 1:2]
        node = self.nodes[self.first_node[:, None] + x + nx * (y + ny * z)]
        # Not matrices[...]: the gradient of that adds up in whatever order threads arrive.
        blended = embedding(self.first_row[:, None] + node, matrices)[..., :12].unflatten(-1, (3, 4))
        along = torch.where(self.offsets.bool(), share, 1.0 - share)
        wx, wy, wz = along.unbind(dim=-1)
        weight = wx * wy * wz
        sign = (2 * self.offsets - 1) * self.inverse_cell
        slope = sign * torch.stack([wy * wz, wx * wz, wx * wy], dim=-1)
        moved = (blended[..., :3] * points[:, None, None]).sum(dim=-1) + blended[..., 3]
        return (weight[..., None, None] * blended[..., :3]).sum(dim=1), moved, weight, slope

    def warp(self, points: Tensor, matrices: Tensor) -> tuple[Tensor, Tensor]:
        """f(x) [M, 3] and its Jacobian [M, 3, 3] at ``points`` [M, 3], which get no gradient."""
        rotation, moved, weight, slope = self.blend(points, matrices)
        jacobian = rotation + (moved[..., :, None] * slope[..., None, :]).sum(dim=1)
        return (weight[..., None] * moved).sum(dim=1), jacobian


def _adjugate(m: Tensor) -> tuple[Tensor, Tensor]:
    """Adjugate [M, 3, 3] and determinant [M]: the inverse is their quotient."""
    first, second, third = m.unbind(dim=-2)
    columns = [torch.linalg.cross(second, third), torch.linalg.cross(third, first), torch.linalg.cross(first, second)]
    return torch.stack(columns, dim=-1), (first * columns[0]).sum(dim=-1)

"""The seam for inverse skinning in voxels: differentiable roots of f(x) = A(x) [x; 1] over blended matrices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.cpu import skinning as cpu
from chona_model.kernels.grid import fast


@dataclass(frozen=True)
class VolumeIndex:
    """Where each of P poses finds its matrices.

    Attributes:
        nodes: int32, node index of every grid corner of all volumes, concatenated.
        first_node: [P] int64 begin of the pose's volume in ``nodes``.
        dims: [P, 3] int64 corners along each axis; origins: [P, 3] float32 lower corner, metres.
        first_row: [P] int64 first row of the pose's matrices.
        inverse_cell: 1/m.
    """

    nodes: np.ndarray
    first_node: np.ndarray
    dims: np.ndarray
    origins: np.ndarray
    first_row: np.ndarray
    inverse_cell: float


@dataclass(frozen=True)
class NewtonLimits:
    """Settings of the voxel root finder: steps at most, tolerance and longest step in metres."""

    steps: int = 4
    tolerance: float = 2e-4
    max_step: float = 0.05


MIN_DETERMINANT = 0.2
"""Roots whose Jacobian is closer to singular than this give no gradient to the matrices."""


class _Invert(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        matrices: Tensor,
        posed: Tensor,
        starts: Tensor,
        pose: Tensor,
        index: VolumeIndex,
        limits: NewtonLimits,
    ) -> tuple[Tensor, Tensor]:
        roots, residuals = torch.empty_like(posed), torch.empty(len(posed))
        cell = np.float32(index.inverse_cell)
        cpu.invert(
            posed.numpy(), starts.numpy(), pose.numpy(), matrices.detach().numpy(), index.nodes, index.first_node,
            index.dims, index.first_row, index.origins, cell, limits.steps, np.float32(limits.tolerance),
            np.float32(limits.max_step), roots.numpy(), residuals.numpy(),
        )  # fmt: skip
        ctx.save_for_backward(matrices, roots, pose)
        ctx.index = index
        ctx.mark_non_differentiable(residuals)
        return roots, residuals

    @staticmethod
    def backward(ctx: Any, grad_roots: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        matrices, roots, pose = ctx.saved_tensors
        index = ctx.index
        grad_matrices = torch.zeros_like(matrices)
        cpu.invert_backward(
            roots.numpy(), grad_roots.contiguous().numpy(), pose.numpy(), matrices.detach().numpy(), index.nodes,
            index.first_node, index.dims, index.first_row, index.origins, np.float32(index.inverse_cell),
            np.float32(MIN_DETERMINANT), grad_matrices.numpy(),
        )  # fmt: skip
        return grad_matrices, None, None, None, None, None


def invert(
    matrices: Tensor, posed: Tensor, starts: Tensor, pose: Tensor, index: VolumeIndex, limits: NewtonLimits
) -> tuple[Tensor, Tensor]:
    """Canonical points of root-space points, from one start each.

    Args:
        matrices: [rows, 12 or more] blended matrices; gradients reach them by the implicit function theorem.
        posed, starts: [M, 3] metres; pose: [M] int32.

    Returns:
        roots [M, 3] and residuals [M], metres.
    """
    if fast(matrices):
        roots, residuals = _Invert.apply(matrices, posed, starts, pose, index, limits)
        return roots, residuals
    return reference.invert(matrices, posed, starts, pose, index, limits, MIN_DETERMINANT)

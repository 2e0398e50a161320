"""Where roots probably are: the skinning perceptron read off at the nodes of a grid, inverted there first.

A step of Newton's method in the perceptron costs some hundred times one in a grid. So the grid leads every start to
where its root should be, starts that meet are followed once, and the perceptron itself decides from there: what is
returned as a root satisfies the exact map to the same tolerance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from chona_model.deform.inverse import first_of_equals
from chona_model.deform.skinning import ForwardSkinning, blend, softmax_weights
from chona_model.figure import PoseBatch
from chona_model.kernels.reference.skinning import warp
from chona_model.kernels.warp import NewtonLimits, VolumeIndex, invert

LIMITS = NewtonLimits(steps=80, tolerance=2e-4, max_step=0.03)
"""Of the search in the grid, metres: short steps, which cost next to nothing here, get round more corners."""

ARRIVED = 0.05
"""Residual in the grid up to which a start is led on, metres: the offset, which the grid leaves out, is far smaller."""

MEETING = 1e-3
"""Starts that the grid leads to within this of each other follow one root, metres."""

ROWS = 8192
"""Nodes that the perceptron reads off at once."""


MayHold = Callable[[Tensor, Tensor], Tensor]
"""(canonical points [A, 3], poses [A] int64) → [A] bool."""


@dataclass(frozen=True)
class Led:
    """What the grid made of M targets' starts.

    Attributes:
        starts: [M, K, 3]; follow: [M, K] bool. Of a target none of whose starts arrived, all stay as they were.
        empty: [M] bool: roots were found, and none where anything could be.
    """

    starts: Tensor
    follow: Tensor
    empty: Tensor


@dataclass(frozen=True)
class Prediction:
    """Skinning of P poses on a grid over canonical space: matrices [P · nodes, 12] and where each pose has its own."""

    matrices: Tensor
    index: VolumeIndex

    def warp(self, points: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
        """Posed points [M, 3] of canonical ones whose poses are ``index`` [M], and the Jacobians [M, 3, 3] there."""
        return warp(self.matrices, points, index, self.index)

    def lead(self, targets: Tensor, starts: Tensor, usable: Tensor, index: Tensor, may_hold: MayHold | None) -> Led:
        """Starts led to where the grid has their roots.

        Args:
            targets: [M, 3] root space, metres; index: [M] their poses.
            starts: [M, K, 3]; usable: [M, K] bool.
            may_hold: which canonical points could hold anything; roots elsewhere are not followed. None: all.
        """
        row, start = usable.nonzero(as_tuple=True)
        led, residuals = invert(
            self.matrices, targets[row].contiguous(), starts[row, start].contiguous(), index[row].int(), self.index,
            LIMITS,
        )  # fmt: skip
        came = residuals <= ARRIVED
        worth = came if may_hold is None else came & may_hold(led, index[row])
        arrived, follow = torch.zeros_like(usable), torch.zeros_like(usable)
        arrived[row, start], follow[row, start] = came, worth
        moved = starts.clone()
        moved[row, start] = led
        follow = first_of_equals(moved, follow, MEETING)
        lost = ~arrived.any(dim=-1)
        return Led(
            torch.where(lost[:, None, None], starts, moved), torch.where(lost[:, None], usable, follow),
            ~lost & ~follow.any(dim=-1),
        )  # fmt: skip


@torch.no_grad()
def predict(
    deform: ForwardSkinning, poses: PoseBatch, lower: Tensor, upper: Tensor, cell: float, offset: bool = False
) -> Prediction:
    """Reads the skinning off at nodes ``cell`` metres apart between the corners ``lower`` and ``upper`` [3].

    Args:
        offset: whether F_Δ is read off too, a node's translation; leading starts does without it.
    """
    dims = np.ceil(((upper - lower) / cell).cpu().numpy()).astype(np.int64) + 1
    axes = [lower[k] + cell * torch.arange(int(dims[k]), device=lower.device, dtype=lower.dtype) for k in range(3)]
    z, y, x = torch.meshgrid(axes[2], axes[1], axes[0], indexing="ij")  # x fastest
    nodes = torch.stack([x, y, z], dim=-1).reshape(-1, 3)
    logits = torch.cat([deform.skinning.logits(rows) for rows in nodes.split(ROWS)])
    matrices = []
    for pose in range(len(poses.transforms)):
        weights = softmax_weights(logits, poses.present[pose : pose + 1])
        first = torch.zeros(1, dtype=torch.int64, device=nodes.device)
        blended = blend(weights, poses.transforms[pose : pose + 1], first)
        if offset:
            code = poses.codes[pose : pose + 1]
            blended[..., 3] += torch.cat([deform.offset(rows, code) for rows in nodes.split(ROWS)])
        matrices.append(blended.flatten(1))
    count, size = len(nodes), len(matrices)
    index = VolumeIndex(
        nodes=np.arange(count, dtype=np.int32), first_node=np.zeros(size, np.int64), dims=np.stack([dims] * size),
        origins=np.stack([lower.cpu().numpy()] * size).astype(np.float32),
        first_row=count * np.arange(size, dtype=np.int64), inverse_cell=1.0 / cell,
    )  # fmt: skip
    return Prediction(torch.cat(matrices).contiguous(), index)

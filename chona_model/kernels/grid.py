"""The seam for grid encodings: layout, and one differentiable function over the fast kernel or its torch twin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.cpu import encode as kernels

cpu: Any = kernels
"""numba's dispatchers take any arguments; a type checker does not know that."""

FEATURES = kernels.FEATURES


@dataclass(frozen=True)
class GridLayout:
    """Shape of a multi-resolution grid.

    Attributes:
        inverse_cells: [L] float32, 1/m, coarse to fine.
        dims: [L, 3] int64 corners along each axis.
        dense: [L] bool: corners are indexed plainly, not hashed.
        rows: table rows a level, a power of two.
    """

    inverse_cells: np.ndarray
    dims: np.ndarray
    dense: np.ndarray
    rows: int

    @property
    def levels(self) -> int:
        """Number of resolutions."""
        return len(self.inverse_cells)


def make_layout(extent: np.ndarray, coarsest: float, finest: float, levels: int, rows: int) -> GridLayout:
    """Cells shrink geometrically from ``coarsest`` to ``finest`` metres over a box of ``extent`` [3] metres."""
    if rows & (rows - 1):
        raise ValueError(f"table rows must be a power of two, got {rows}")
    cells = np.geomspace(coarsest, finest, levels)
    dims = np.ceil(np.asarray(extent)[None] / cells[:, None]).astype(np.int64) + 2
    return GridLayout((1.0 / cells).astype(np.float32), dims, dims.prod(axis=1) <= rows, rows)


class TableGradient:
    """The gradient of a grid table, accumulated in place by the kernel: no dense zero buffer a step."""

    def __init__(self, table: Tensor) -> None:
        self.buffer = torch.zeros_like(table)


class _Encode(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, points: Tensor, identity: Tensor, table: Tensor, layout: GridLayout, gradient: TableGradient
    ) -> Tensor:
        out = torch.empty(len(points), layout.levels * FEATURES)
        arguments = (layout.inverse_cells, layout.dims, layout.dense, layout.rows)
        cpu.encode(points.numpy(), identity.numpy(), table.detach().numpy(), *arguments, out.numpy())
        ctx.save_for_backward(points, identity, table)
        ctx.arguments, ctx.gradient = arguments, gradient
        return out

    @staticmethod
    def backward(ctx: Any, grad_out: Tensor) -> tuple[Tensor | None, ...]:
        points, identity, table = ctx.saved_tensors
        grad = grad_out.contiguous().numpy()
        cpu.encode_backward_table(points.numpy(), identity.numpy(), grad, *ctx.arguments, ctx.gradient.buffer.numpy())
        grad_points = None
        if ctx.needs_input_grad[0]:
            grad_points = torch.empty_like(points)
            cpu.encode_backward_points(
                points.numpy(), identity.numpy(), table.detach().numpy(), grad, *ctx.arguments, grad_points.numpy()
            )
        return grad_points, None, None, None, None


def fast(tensor: Tensor) -> bool:
    """Whether the numba kernels take this tensor: float32 on the CPU."""
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32


def encode(
    points: Tensor, identity: Tensor, table: Tensor, layout: GridLayout, gradient: TableGradient | None = None
) -> Tensor:
    """Interpolated grid features.

    Args:
        points: [M, 3] metres from each identity's lower corner, ≥ 0.
        identity: [M] int32.
        table: [I, L, T, FEATURES].
        gradient: where the fast kernel accumulates the table's gradient; without one the torch twin is used, whose
            gradient goes to ``table.grad`` as usual.

    Returns:
        [M, L · FEATURES].
    """
    if not fast(points):
        return reference.encode(points, identity, table, layout)
    if gradient is None and torch.is_grad_enabled() and (table.requires_grad or points.requires_grad):
        return reference.encode(points, identity, table, layout)
    if gradient is None:
        out = torch.empty(len(points), layout.levels * FEATURES)
        cpu.encode(
            points.detach().numpy(), identity.numpy(), table.detach().numpy(),
            layout.inverse_cells, layout.dims, layout.dense, layout.rows, out.numpy(),
        )  # fmt: skip
        return out
    return _Encode.apply(points, identity, table, layout, gradient)

"""The seam for grid encodings: layout, and one differentiable function over the fast kernel or its torch twin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.cpu import encode as kernels
from chona_model.kernels.threads import in_pieces

cpu: Any = kernels
"""numba's dispatchers take any arguments; a type checker does not know that."""

FEATURES = kernels.FEATURES

PIECE = 4096
"""Points a thread takes at once."""


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

    def arguments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """As the kernels take them."""
        return self.inverse_cells, self.dims, self.dense, self.rows


def make_layout(extent: np.ndarray, coarsest: float, finest: float, levels: int, rows: int) -> GridLayout:
    """Cells shrink geometrically from ``coarsest`` to ``finest`` metres over a box of ``extent`` [3] metres."""
    if rows & (rows - 1):
        raise ValueError(f"table rows must be a power of two, got {rows}")
    cells = np.geomspace(coarsest, finest, levels)
    return layout_of(np.ceil(np.asarray(extent)[None] / cells[:, None]).astype(np.int64) + 2, coarsest, finest, rows)


def layout_of(dims: np.ndarray, coarsest: float, finest: float, rows: int) -> GridLayout:
    """The layout with so many corners, ``dims`` [L, 3], in every level."""
    cells = np.geomspace(coarsest, finest, len(dims))
    return GridLayout((1.0 / cells).astype(np.float32), dims, dims.prod(axis=1) <= rows, rows)


def grow_layout(layout: GridLayout, extent: np.ndarray) -> GridLayout:
    """The layout over a box that may be larger, for tables that are laid out by ``layout`` now (see ``lay_out_anew``).

    Where a point's features are found does not change in hashed levels.  A dense level whose corners would not fit into
    its rows any more keeps its size: beyond it counts as its border, and the finer levels tell points apart there.

    Args:
        extent: [3] metres.
    """
    cells = 1.0 / layout.inverse_cells.astype(np.float64)
    needed = np.ceil(np.asarray(extent)[None] / cells[:, None]).astype(np.int64) + 2
    dims = np.maximum(layout.dims, needed)
    fits = ~layout.dense | (dims.prod(axis=1) <= layout.rows)
    return replace(layout, dims=np.where(fits[:, None], dims, layout.dims))


def lay_out_anew(table: Tensor, old: GridLayout, new: GridLayout) -> Tensor:
    """Tables [I, L, T, FEATURES] of the layout ``old`` as ``new`` = ``grow_layout(old, …)`` looks features up."""
    result = table.clone()
    for level in np.flatnonzero(old.dense & (old.dims != new.dims).any(axis=1)):
        nx, ny, nz = map(int, old.dims[level])
        wide, deep = map(int, new.dims[level, :2])
        x, y, z = np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij")
        result[:, level, x + wide * (y + deep * z)] = table[:, level, x + nx * (y + ny * z)]
    return result


class TableGradient:
    """The gradient of a grid table, accumulated in place by the kernel: no dense zero buffer a step.

    Attributes:
        buffer: [I, L, T, FEATURES]; touched: [I · L · T] uint8, rows whose gradient may not be zero.
    """

    def __init__(self, table: Tensor) -> None:
        self.buffer = torch.zeros_like(table)
        self.touched = np.zeros(table.numel() // FEATURES, dtype=np.uint8)


class _Encode(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, points: Tensor, identity: Tensor, table: Tensor, layout: GridLayout, gradient: TableGradient
    ) -> Tensor:
        ctx.save_for_backward(points, identity, table)
        ctx.layout, ctx.gradient = layout, gradient
        return _encode(points, identity, table, layout)

    @staticmethod
    def backward(ctx: Any, grad_out: Tensor) -> tuple[Tensor | None, ...]:
        points, identity, table = ctx.saved_tensors
        head = (points.numpy(), identity.numpy(), np.zeros((len(table), 3), dtype=np.float32))
        grad, arguments = grad_out.contiguous().numpy(), ctx.layout.arguments()
        buffer, touched = ctx.gradient.buffer.numpy(), ctx.gradient.touched
        in_pieces(
            lambda level, _: cpu.encode_backward_table(level, *head, grad, *arguments, buffer, touched),
            ctx.layout.levels,
            1,
        )
        grad_points = None
        if ctx.needs_input_grad[0]:
            grad_points = torch.empty_like(points)
            rest = (*head, table.detach().numpy(), grad, *arguments, grad_points.numpy())
            in_pieces(lambda begin, end: cpu.encode_backward_points(begin, end, *rest), len(points), PIECE)
        return grad_points, None, None, None, None


def _encode(points: Tensor, identity: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
    out = torch.empty(len(points), layout.levels * FEATURES)
    lower = np.zeros((len(table), 3), dtype=np.float32)
    arrays = (points.detach().numpy(), identity.numpy(), lower, table.detach().numpy())
    rest = (*arrays, *layout.arguments(), out.numpy())
    in_pieces(lambda level, _: cpu.encode(level, *rest), layout.levels, 1)
    return out


def fast(tensor: Tensor) -> bool:
    """Whether the numba kernels take this tensor: float32 on the CPU."""
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32


def encode(
    points: Tensor, identity: Tensor, table: Tensor, layout: GridLayout, gradient: TableGradient | None = None
) -> Tensor:
    """Interpolated grid features.

    Args:
        points: [M, 3] metres from each identity's lower corner; outside the grid counts as on its border.
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
        return _encode(points, identity, table, layout)
    return _Encode.apply(points, identity, table, layout, gradient)

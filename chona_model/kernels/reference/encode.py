"""Multi-resolution grid encoding in plain torch; gradients to points and table come from autograd."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn.functional import embedding

if TYPE_CHECKING:
    from chona_model.kernels.grid import GridLayout

PRIME_Y = 2654435761
PRIME_Z = 805459861


def encode(points: Tensor, identity: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
    """Interpolated features of every level.

    Args:
        points: [M, 3] metres from each identity's lower corner; outside the grid counts as on its border.
        identity: [M] integer.
        table: [I, L, T, F].
        layout: the grid's shape.

    Returns:
        [M, L · F], in the points' dtype.
    """
    return encode_levels(
        points, identity, table, layout.inverse_cells.tolist(), layout.dims.tolist(), layout.dense.tolist(), layout.rows
    )


def encode_levels(
    points: Tensor, identity: Tensor, table: Tensor, cells: Sequence[float], dims: Sequence[Sequence[int]],
    dense: Sequence[bool], rows: int,
) -> Tensor:  # fmt: skip
    """``encode`` with the layout in plain numbers, as ``torch.compile`` wants them."""
    levels, features = table.shape[1], table.shape[3]
    flat = table.reshape(-1, features)
    offsets = corner_offsets(points.device)
    first_row = identity.long() * levels
    columns = []
    for level in range(levels):
        scaled = torch.stack(
            [(points[:, axis] * cells[level]).clamp(0.0, dims[level][axis] - 1) for axis in range(3)], dim=1
        )
        # Whatever a conversion makes of a NaN, no index leaves the grid: the NaN stays in the weights.
        lower = torch.stack(
            [scaled.detach()[:, axis].long().clamp(0, dims[level][axis] - 2) for axis in range(3)], dim=1
        )
        share = scaled - lower
        weight = torch.where(offsets.bool(), share[:, None], 1.0 - share[:, None])
        weight = weight[..., 0] * weight[..., 1] * weight[..., 2]
        row = _corner_rows(lower[:, None] + offsets, dims[level], dense[level], rows)
        row = row + ((first_row + level) * rows)[:, None]
        # Not flat[row]: the gradient of that adds up in whatever order threads arrive.
        columns.append((weight[..., None] * embedding(row, flat)).sum(dim=1))
    return torch.cat(columns, dim=-1)


def corner_offsets(device: torch.device) -> Tensor:
    """[8, 3] steps from a cell's lower corner to all of its corners, x fastest."""
    corner = torch.arange(8, device=device)
    return torch.stack([corner & 1, (corner >> 1) & 1, corner >> 2], dim=-1)


def _corner_rows(corners: Tensor, dims: Sequence[int], dense: bool, rows: int) -> Tensor:
    """Rows [M, 8] of grid corners [M, 8, 3] inside their level: the plain index where it is dense, else the hash."""
    x, y, z = corners.unbind(dim=-1)
    if dense:
        return x + dims[0] * (y + dims[1] * z)
    # The low bits of 64-bit products are those of 32-bit ones, and the mask keeps no others.
    return (x ^ (y * PRIME_Y) ^ (z * PRIME_Z)) & (rows - 1)

"""Light on surfaces in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from chona_model.kernels.reference.encode import corner_offsets

FAINT = 1e-12
"""Squared length under which a normal says nothing."""


def normals_at(
    points: Tensor, part: Tensor, normals: Tensor, first: Tensor, dims: Tensor, origins: Tensor, inverse_cell: float
) -> Tensor:
    """Normals [M, 3], of any length, at points in their parts' frames: interpolated between the centres of cells.

    Args:
        points: [M, 3] metres; part: [M] integer.
        normals: [cells, 3] of all parts; first, dims, origins, inverse_cell: their grids (see ``marching.Occupancy``).
    """
    part = part.long()
    size = dims[part]
    place = (points - origins[part]) * inverse_cell - 0.5
    place = torch.minimum(place.clamp(min=0.0), (size - 1).to(points.dtype) - 1e-3)
    lower = torch.minimum(place.long().clamp(min=0), (size - 2).clamp(min=0))  # whatever a conversion makes of a NaN
    offsets = corner_offsets(points.device)
    share = (place - lower)[:, None]
    weight = torch.where(offsets.bool(), share, 1.0 - share).prod(dim=-1)
    x, y, z = (lower[:, None] + offsets).unbind(dim=-1)
    cell = first[part][:, None] + x + size[:, :1] * (y + size[:, 1:2] * z)
    return (weight[..., None] * normals[cell]).sum(dim=1)


def gains(normals: Tensor, light: Tensor) -> Tensor:
    """What a pose's light makes of colours: factors [M, 3].

    Args:
        normals: [M, 3] root space, of any length; light: [M, 9, 3] or [9, 3] (see ``field.light.root_light``).
    """
    square = normals.square().sum(dim=-1, keepdim=True)
    scale = torch.where(square > FAINT, square.clamp(min=FAINT).rsqrt(), 0.0)
    return torch.exp((terms(normals * scale)[..., None] * light).sum(dim=-2))


def terms(normals: Tensor) -> Tensor:
    """[M, 9] terms of a quadratic in unit normals [M, 3]: x, y, z, x², y², z², xy, yz, zx."""
    return torch.cat([normals, normals.square(), normals * normals.roll(-1, dims=-1)], dim=-1)

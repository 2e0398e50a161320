"""Gaussians of the pieces of cones and cylinders that rays sweep (mip-NeRF's conical frusta).

Rays have unit length along the camera axis, not Euclidean; ``t`` is that depth and radii are given at depth 1.
"""

from __future__ import annotations

import torch
from torch import Tensor


def conical_frusta(origins: Tensor, directions: Tensor, radii: Tensor, edges: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and covariance of the frusta between consecutive depths of a cone with its tip at the origin.

    mip-NeRF's moments, written in q = half width / middle (0 … 1 for depths ≥ 0) so that nothing is 0/0 at depth 0 and
    no fourth power overflows at depth 1e18.

    Args:
        origins, directions: [R, 3].
        radii: [R] cone radius at depth 1, metres.
        edges: [R, S + 1] depths ≥ 0, increasing.

    Returns:
        depths: [R, S] of the means; means: [R, S, 3]; covariances: [R, S, 3, 3], square metres.
    """
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])
    half = 0.5 * (edges[..., 1:] - edges[..., :-1])
    q = torch.where(middle > 0, half / torch.where(middle > 0, middle, 1.0), 0.0).clamp(max=1.0).square()
    third = 3.0 + q
    depth = middle + half * torch.sqrt(q) * 2.0 / third
    along = half.square() * (1.0 / 3.0 - (4.0 / 15.0) * q * (12.0 - q) / third.square())
    across = (radii[..., None] * middle).square() * (0.25 + (5.0 / 12.0) * q - (4.0 / 15.0) * q.square() / third)
    return depth, *_gaussians(origins, directions, depth, along, across)


def cylinders(origins: Tensor, directions: Tensor, radii: Tensor, edges: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The same for orthographic cameras: pieces of a cylinder of constant radius [R], metres."""
    depth = 0.5 * (edges[..., 1:] + edges[..., :-1])
    along = (edges[..., 1:] - edges[..., :-1]).square() / 12.0
    across = (0.25 * radii.square())[..., None].expand_as(along)
    return depth, *_gaussians(origins, directions, depth, along, across)


def _gaussians(
    origins: Tensor, directions: Tensor, depth: Tensor, along: Tensor, across: Tensor
) -> tuple[Tensor, Tensor]:
    means = origins[..., None, :] + depth[..., None] * directions[..., None, :]
    outer = directions[..., :, None] * directions[..., None, :]
    # Directions have length ≥ 1 (unit along the camera axis), so this never divides by zero.
    parallel = outer / directions.square().sum(dim=-1)[..., None, None]
    perpendicular = torch.eye(3, dtype=means.dtype, device=means.device) - parallel
    covariances = (
        along[..., None, None] * outer[..., None, :, :] + across[..., None, None] * perpendicular[..., None, :, :]
    )
    return means, covariances

"""Positional encodings of points and of Gaussians, without π: frequencies 1, 2, 4, … in radians a unit."""

from __future__ import annotations

import torch
from torch import Tensor


def encoding_size(degrees: int, identity: bool) -> int:
    """Number of features that ``positional_encoding`` (identity True) or ``integrated_encoding`` (False) gives."""
    return 3 * (2 * degrees + int(identity))


def _frequencies(degrees: int, like: Tensor) -> Tensor:
    return torch.pow(2.0, torch.arange(degrees, device=like.device, dtype=like.dtype))


def positional_encoding(points: Tensor, degrees: int) -> Tensor:
    """The points themselves, then sin and cos of 2^k x for k = 0 … degrees - 1.

    Args:
        points: [..., 3], of the order of 1.

    Returns:
        [..., 3 (1 + 2 degrees)].
    """
    scaled = points[..., None, :] * _frequencies(degrees, points)[:, None]
    blocks = torch.cat([points[..., None, :], torch.sin(scaled), torch.cos(scaled)], dim=-2)
    return blocks.flatten(-2)


def positional_encoding_tangents(points: Tensor, degrees: int) -> Tensor:
    """Derivatives of ``positional_encoding`` by the three coordinates: [3, ..., 3 (1 + 2 degrees)]."""
    frequencies = _frequencies(degrees, points)[:, None]
    scaled = points[..., None, :] * frequencies
    blocks = torch.cat(
        [torch.ones_like(points)[..., None, :], frequencies * torch.cos(scaled), -frequencies * torch.sin(scaled)],
        dim=-2,
    )
    # Every feature depends on one coordinate only: a diagonal in (feature's coordinate, tangent).
    return torch.diag_embed(blocks).movedim(-1, 0).flatten(-2)


def integrated_encoding(mean: Tensor, covariance: Tensor, degrees: int) -> Tensor:
    """Expectation of sin and cos of 2^k x under a Gaussian (mip-NeRF's integrated positional encoding).

    ``E[sin(2^k x)] = sin(2^k μ) exp(-4^k σ² / 2)``; with axis-aligned frequencies only the covariance's diagonal acts.

    Args:
        mean: [..., 3], of the order of 1.
        covariance: [..., 3, 3] in full, or its diagonal [..., 3]; variances from 0 to 1e30.

    Returns:
        [..., 6 degrees] of the mean's dtype, computed in float32 at least; features whose period is far below the
        Gaussian's width vanish.
    """
    if mean.dtype in {torch.float16, torch.bfloat16}:
        return integrated_encoding(mean.float(), covariance.float(), degrees).to(mean.dtype)
    full = covariance.dim() == mean.dim() + 1
    variance = torch.diagonal(covariance, dim1=-2, dim2=-1) if full else covariance
    # Rounding of a warped covariance may leave -1e-12; above 1e30 times 4^k would leave float32's range.
    variance = variance.clamp(0.0, 1e30)
    frequencies = _frequencies(degrees, mean)[:, None]
    decay = torch.exp(-0.5 * variance[..., None, :] * frequencies.square())
    scaled = mean[..., None, :] * frequencies
    return torch.cat([torch.sin(scaled) * decay, torch.cos(scaled) * decay], dim=-2).flatten(-2)

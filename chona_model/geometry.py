"""Safe basics: distances to bones, rays against boxes, 3x3 inverses and functions whose gradients stay finite.

Functions that would divide by zero first replace the *argument* and then choose the result (the double ``where``), so
that no NaN travels back through the branch that was not taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

SINGULAR_DETERMINANT = 1e-4
"""Below this |determinant| of a 3x3 matrix scaled to unit Frobenius norm per axis, the inverse is damped and flagged.

A rotation has 1; 1e-4 means that a volume element shrinks ten thousand times more than its mean edge says."""

SMALLEST_SCALE = 1e6
"""Matrices whose entries stay below this many times the smallest normal number are zero: no inverse is in range."""

DAMPING = 1e-2
"""Levenberg damping of singular matrices, as a share of the matrix's scale."""


def safe_sqrt(values: Tensor) -> Tensor:
    """Square root of max(values, 0), with gradient 0 instead of infinity where values ≤ 0."""
    positive = values > 0
    return torch.where(positive, torch.sqrt(torch.where(positive, values, 1.0)), 0.0)


def safe_norm(vectors: Tensor, keepdim: bool = False) -> Tensor:
    """Euclidean length along the last axis, with gradient 0 at the zero vector.

    Vectors are scaled by their largest component first, so lengths from 1e-38 to 1e38 neither vanish nor overflow.
    """
    largest = vectors.detach().abs().amax(dim=-1, keepdim=True)
    scale = torch.where(largest > 0, largest, 1.0)
    length = safe_sqrt((vectors / scale).square().sum(dim=-1, keepdim=True)) * scale
    return length if keepdim else length.squeeze(-1)


def safe_divide(numerator: Tensor, denominator: Tensor, fallback: float = 0.0) -> Tensor:
    """numerator / denominator, and ``fallback`` with zero gradient where the denominator is exactly 0."""
    usable = denominator != 0
    return torch.where(usable, numerator / torch.where(usable, denominator, 1.0), fallback)


def segment_distances(points: Tensor, heads: Tensor, tails: Tensor) -> Tensor:
    """Distances from points to bone segments; a bone of zero length is a point.

    Args:
        points: [..., 3], metres.
        heads, tails: [..., 3], broadcast against ``points``.

    Returns:
        [...] metres, ≥ 0, with finite gradients also on the bone.
    """
    along = tails - heads
    length_squared = along.square().sum(dim=-1)
    share = safe_divide(((points - heads) * along).sum(dim=-1), length_squared).clamp(0.0, 1.0)
    return safe_norm(points - heads - share[..., None] * along)


def box_distances(points: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """Distances from points [..., 3] to axis-aligned boxes, 0 inside; a box of no extent is a point. [...] metres."""
    outside = torch.clamp(lower - points, min=0.0) + torch.clamp(points - upper, min=0.0)
    return safe_norm(outside)


def ray_box(origins: Tensor, directions: Tensor, lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Where rays enter and leave an axis-aligned box, counted from their origin forwards.

    Rays parallel to a slab (also those lying in its plane, which count as inside) constrain nothing or miss; rays that
    start inside enter at 0.

    Args:
        origins, directions: [..., 3]; a direction of zero hits where its origin is inside, over an unbounded range.
        lower, upper: [..., 3] corners with lower ≤ upper.

    Returns:
        near, far: [...] ray parameters ≥ 0, both 0 where the ray misses; hit: [...] bool. A ray that only touches
        the box hits, with near = far.
    """
    moving = directions != 0
    step = torch.where(moving, directions, 1.0)
    first, second = (lower - origins) / step, (upper - origins) / step
    inside_slab = (origins >= lower) & (origins <= upper)
    infinity = torch.full_like(first, torch.inf)
    entry = torch.where(moving, torch.minimum(first, second), torch.where(inside_slab, -infinity, infinity))
    leave = torch.where(moving, torch.maximum(first, second), torch.where(inside_slab, infinity, -infinity))
    near = entry.amax(dim=-1).clamp(min=0.0)
    far = leave.amin(dim=-1)
    hit = far >= near
    return torch.where(hit, near, 0.0), torch.where(hit, far, 0.0), hit


@dataclass(frozen=True)
class Inverse3x3:
    """Inverses of a batch of 3x3 matrices.

    Attributes:
        matrix: [..., 3, 3] the inverse, or the damped pseudo-inverse where ``regular`` is False; always finite for
            finite input.
        regular: [...] bool, False where the scaled determinant is below ``SINGULAR_DETERMINANT`` or the matrix holds
            a value that is not finite (its inverse is then zero).
    """

    matrix: Tensor
    regular: Tensor


def inverse_3x3(matrices: Tensor) -> Inverse3x3:
    """Closed-form inverse of [..., 3, 3]; singular matrices are damped and flagged, never raised.

    The matrix is scaled by its root mean square before the determinant is tested, so a model in millimetres is no
    more singular than one in metres.  Singular ones get ``(MᵀM + λ²I)⁻¹ Mᵀ``, whose steps are short in the directions
    that M loses.
    """
    finite = torch.isfinite(matrices).all(dim=-1).all(dim=-1)
    usable = torch.where(finite[..., None, None], matrices, 0.0)
    largest = usable.abs().amax(dim=(-2, -1), keepdim=True)
    # A matrix of 1e-38 has no inverse in float32's range: it counts as zero.
    nothing = largest <= SMALLEST_SCALE * torch.finfo(matrices.dtype).tiny
    usable = torch.where(nothing, 0.0, usable)
    peak = torch.where(nothing, 1.0, largest)
    scale = peak * torch.sqrt((usable / peak).square().sum(dim=(-2, -1), keepdim=True) / 3.0)
    scale = torch.where(nothing, 1.0, scale)
    unit = usable / scale
    adjugate, determinant = _adjugate(unit)
    regular = (determinant.abs() > SINGULAR_DETERMINANT) & finite
    inverse = adjugate / torch.where(regular, determinant, 1.0)[..., None, None]
    if not bool(regular.all()):
        inverse = torch.where(regular[..., None, None], inverse, _damped(unit))
    return Inverse3x3(torch.where(finite[..., None, None], inverse / scale, 0.0), regular)


def _damped(unit: Tensor) -> Tensor:
    """``(MᵀM + λ²I)⁻¹ Mᵀ`` of matrices of scale 1, in float64: ranks 0 and 1 leave determinants of λ⁶ and λ⁴."""
    exact = unit.double()
    transposed = exact.transpose(-1, -2)
    adjugate, determinant = _adjugate(
        transposed @ exact + DAMPING**2 * torch.eye(3, dtype=torch.float64, device=unit.device)
    )
    return (adjugate / determinant[..., None, None] @ transposed).to(unit.dtype)


def _adjugate(m: Tensor) -> tuple[Tensor, Tensor]:
    """Adjugate [..., 3, 3] and determinant [...] by cross products of the rows."""
    first, second, third = m[..., 0, :], m[..., 1, :], m[..., 2, :]
    columns = torch.stack(
        [
            torch.linalg.cross(second, third),
            torch.linalg.cross(third, first),
            torch.linalg.cross(first, second),
        ],
        dim=-1,
    )
    return columns, (first * columns[..., 0]).sum(dim=-1)

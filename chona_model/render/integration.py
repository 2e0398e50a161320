"""Volume integration along rays: optical depths in, premultiplied colour, alpha, depth and mattes out.

The paper prints ``1 - exp(σδ)``; the opacity of an interval is ``1 - exp(-σδ)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

EMPTY_DEPTH = 1e10
"""Depth where nothing is hit, as Blender writes it."""

LARGEST_OPTICAL_DEPTH = 1e30
"""Optical depths are clamped here: density times length may exceed float32, and exp(-1e30) is 0 anyway."""


@dataclass(frozen=True)
class RayWeights:
    """How much each interval of a ray shows.

    Attributes:
        weights: [R, S] share of the pixel; with ``remaining`` they sum to 1.
        opacity: [R, S] 1 - exp(-σδ) of the interval alone.
        transmittance: [R, S] light that reaches the interval.
        remaining: [R] light that passes all of them.
    """

    weights: Tensor
    opacity: Tensor
    transmittance: Tensor
    remaining: Tensor


def ray_weights(density: Tensor, lengths: Tensor) -> RayWeights:
    """Weights from cumulative sums of optical depth: T_i = exp(-Σ_{j<i} σ_j δ_j), w_i = T_i (1 - exp(-σ_i δ_i)).

    Args:
        density: [R, S] per metre, ≥ 0.
        lengths: [R, S] Euclidean metres, ≥ 0 and finite, the last one too.

    Half precision is computed in float32: its exponents end at 65504, long before optical depths do.

    A density of 2 in the middle of three intervals of 0.5 m gives the weights (0, 1 - e⁻¹, 0) and leaves e⁻¹.
    """
    if density.dtype in {torch.float16, torch.bfloat16}:
        density, lengths = density.float(), lengths.float()
    optical = (density * lengths).clamp(max=LARGEST_OPTICAL_DEPTH)
    passed = torch.cumsum(optical, dim=-1)
    before = torch.cat([torch.zeros_like(passed[..., :1]), passed[..., :-1]], dim=-1)
    transmittance = torch.exp(-before)
    opacity = -torch.expm1(-optical)
    remaining = torch.exp(-passed[..., -1])
    return RayWeights(transmittance * opacity, opacity, transmittance, remaining)


@dataclass(frozen=True)
class Integrated:
    """Pixels: ``rgb`` [R, 3] premultiplied, ``alpha`` [R], ``depth`` [R] metres along the camera axis (1e10 where
    alpha is 0), ``mattes`` [R, Q] the shares of alpha that the Q parts own."""

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    mattes: Tensor


def integrate(weights: Tensor, rgb: Tensor, depths: Tensor, shares: Tensor) -> Integrated:
    """Sums samples into pixels.

    Args:
        weights: [R, S] from ``ray_weights``.
        rgb: [R, S, 3] straight colours.
        depths: [R, S] metres along the camera axis.
        shares: [R, S, Q] how much of each sample belongs to each part, 0…1.
    """
    alpha = weights.sum(dim=-1)
    hit = alpha > 0
    # Weights are normalised first: alpha may be 1e-38, where sums of products would underflow.
    normalised = weights / torch.where(hit, alpha, 1.0)[..., None]
    depth = torch.where(hit, (normalised * depths).sum(dim=-1), EMPTY_DEPTH)
    return Integrated(
        rgb=(weights[..., None] * rgb).sum(dim=-2),
        alpha=alpha,
        depth=depth,
        mattes=(weights[..., None] * shares).sum(dim=-2),
    )


def visible_confidence(ray: RayWeights, converged: Tensor) -> Tensor:
    """Share of what a pixel shows that rests on converged samples.

    A sample without a root has no density, hence no weight of its own: it counts with the opacity of its more opaque
    neighbour, times the light that reaches it.  A failure inside or at a surface therefore lowers the pixel's
    confidence, one behind it or in empty air does not.  Where nothing is visible the samples are counted equally.

    Args:
        converged: [R, S] bool.

    Returns:
        [R] in 0…1, no gradient.
    """
    opacity = ray.opacity.detach()
    neighbours = torch.zeros_like(opacity)
    neighbours[..., 1:] = opacity[..., :-1]
    neighbours[..., :-1] = torch.maximum(neighbours[..., :-1], opacity[..., 1:])
    visible = ray.transmittance.detach() * torch.where(converged, opacity, neighbours)
    total = visible.sum(dim=-1)
    seen = total > 0
    counted = converged.to(opacity.dtype)
    by_weight = (visible * counted).sum(dim=-1) / torch.where(seen, total, 1.0)
    return torch.where(seen, by_weight, counted.mean(dim=-1))

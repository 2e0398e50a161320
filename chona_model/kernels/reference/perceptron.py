"""The grid field's perceptrons in plain torch, with automatic gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn.functional import linear, relu, softplus

if TYPE_CHECKING:
    from chona_model.kernels.perceptron import FieldWeights

SHADE_BIAS = 2.0
"""Ambient occlusion starts at sigmoid(2) = 0.88: nearly open, with a gradient both ways."""


def perceptron(
    encoded: Tensor, weights: FieldWeights, pair: Tensor, pose: Tensor, density_scale: float
) -> tuple[Tensor, Tensor]:
    """Density and colour from encoded points.

    Args:
        encoded: [M, E] grid features; pair, pose: [M] int64 rows of ``weights``' conditioned biases.
        density_scale: 1/m.

    Returns:
        density [M] 1/m, rgb [M, 3] in 0…1.
    """
    w = weights
    hidden = relu(linear(encoded, w.density_in) + w.density_bias[pair])
    raw = linear(hidden, w.density_out, w.density_out_bias)
    density = density_scale * softplus(raw[:, 0] - 1.0)
    features = raw[:, 1:]
    hidden = relu(linear(torch.cat([encoded, features], dim=1), w.colour_in) + w.colour_bias[pair])
    rgb = torch.sigmoid(linear(hidden, w.colour_out, w.colour_out_bias))
    if w.shade_bias is not None:
        shade = relu(linear(features, w.shade_in) + w.shade_bias[pose])
        rgb = rgb * torch.sigmoid(linear(shade, w.shade_out, w.shade_out_bias) + SHADE_BIAS)
    return density, rgb

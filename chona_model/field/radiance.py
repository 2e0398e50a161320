"""The conditional radiance field F_Θr(x_c, Σ, v_h, v_o) → (colour, density), with pose-dependent ambient occlusion."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from chona_model.field.encodings import encoding_size, integrated_encoding
from chona_model.field.mlp import ConditionedMLP, conditioned_linear, dense

DENSITY_SHIFT = -1.0
"""Added before softplus: a fresh field starts almost transparent (mip-NeRF)."""


@dataclass(frozen=True)
class FieldShape:
    """Sizes of the radiance field; the defaults are mip-NeRF's and TAVA's.

    Attributes:
        degrees: octaves of the integrated encoding.
        width, depth, skip: of the trunk.
        head_width: of the layer before colour and before occlusion.
    """

    degrees: int = 10
    width: int = 256
    depth: int = 8
    skip: int = 4
    head_width: int = 128

    def __post_init__(self) -> None:
        widths = 1 <= self.width <= 8192 and 1 <= self.head_width <= 8192
        if not (widths and 0 <= self.degrees <= 32 and 1 <= self.depth <= 128 and 0 <= self.skip <= 128):
            raise ValueError(f"sizes of the radiance field out of range: {self}")


@dataclass(frozen=True)
class FieldSample:
    """``rgb`` [M, 3] in 0…1, sRGB encoded, occlusion applied; ``density`` [M] per metre; ``occlusion`` [M] in 0…1,
    the factor that was applied (ones without shading)."""

    rgb: Tensor
    density: Tensor
    occlusion: Tensor


class RadianceField(nn.Module):
    """Lambertian: nothing depends on where it is seen from.

    Args:
        condition: length of the identity codes side by side.
        pose: length of the pose code that the ambient occlusion depends on.
        centre: [3] canonical metres that become 0 before encoding.
        scale: metres that become 1.
    """

    def __init__(self, shape: FieldShape, condition: int, pose: int, centre: tuple[float, ...], scale: float) -> None:
        super().__init__()
        self.shape, self.condition, self.scale = shape, condition, scale
        self.register_buffer("centre", torch.tensor(centre, dtype=torch.float64), persistent=False)
        inputs = encoding_size(shape.degrees, identity=False)
        self.trunk = ConditionedMLP(inputs, shape.width, shape.depth, condition=condition, skip=shape.skip)
        self.density_layer = dense(shape.width, 1)
        self.bottleneck = dense(shape.width, shape.width)
        self.colour_layer = dense(shape.width + condition, shape.head_width)
        self.colour_output = dense(shape.head_width, 3)
        self.occlusion_bottleneck = dense(shape.width, shape.width)
        self.occlusion_layer = dense(shape.width + pose, shape.head_width)
        self.occlusion_output = dense(shape.head_width, 1)

    def _features(self, means: Tensor, covariances: Tensor, identity: Tensor, identity_index: Tensor | None) -> Tensor:
        centre = self.get_buffer("centre").to(means)
        encoded = integrated_encoding((means - centre) / self.scale, covariances / self.scale**2, self.shape.degrees)
        return self.trunk(encoded, identity, identity_index)

    def _density(self, features: Tensor) -> Tensor:
        return functional.softplus(self.density_layer(features)[..., 0] + DENSITY_SHIFT)

    def density(
        self, means: Tensor, covariances: Tensor, identity: Tensor, identity_index: Tensor | None = None
    ) -> Tensor:
        """Density [M] per metre alone; arguments as ``forward``."""
        return self._density(self._features(means, covariances, identity, identity_index))

    def forward(
        self,
        means: Tensor,
        covariances: Tensor,
        identity: Tensor,
        pose: Tensor | None,
        *,
        identity_index: Tensor | None = None,
        pose_index: Tensor | None = None,
    ) -> FieldSample:
        """Colour and density of canonical Gaussians.

        Args:
            means: [M, 3] canonical metres.
            covariances: [M, 3, 3], or [M, 3] diagonals, square metres.
            identity: [U, condition] codes and identity_index [M]; the index may be missing where U is 1 or M.
            pose: [P, pose] codes and pose_index [M], or None for no occlusion (factor 1).
        """
        features = self._features(means, covariances, identity, identity_index)
        colour = functional.relu(
            conditioned_linear(self.colour_layer, self.bottleneck(features), identity, identity_index)
        )
        rgb = torch.sigmoid(self.colour_output(colour))
        occlusion = torch.ones_like(rgb[..., 0])
        if pose is not None:
            shade = functional.relu(
                conditioned_linear(self.occlusion_layer, self.occlusion_bottleneck(features), pose, pose_index)
            )
            occlusion = torch.sigmoid(self.occlusion_output(shade)[..., 0])
        return FieldSample(rgb * occlusion[..., None], self._density(features), occlusion)

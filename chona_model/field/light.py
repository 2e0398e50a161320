"""A light that stays where it is while figures turn: learned from captures, fixed in the world.

The paper's colour is canonical, darkened by pose-dependent occlusion. Captures have lights, and a surface that turns
away from one gets darker in every pose alike; learned from the pose code alone, that does not carry over to new
poses. Here the logarithm of a colour's gain is a quadratic in the surface's normal: spherical harmonics up to
degree two, which diffuse surfaces hardly exceed (Ramamoorthi and Hanrahan 2001).
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

COEFFICIENTS = 8
"""Of a light, each for red, green and blue: three of degree one, five of degree two."""


def root_light(light: Tensor, root_from_world: np.ndarray) -> Tensor:
    """A light as poses see it in their root spaces; differentiable.

    Args:
        light: [COEFFICIENTS, 3] in the world; root_from_world: [P, 3, 3] rotations.

    Returns:
        [P, 9, 3] factors of x, y, z, x², y², z², xy, yz, zx of a root-space normal in the gain's logarithm.
    """
    turn = torch.as_tensor(root_from_world, dtype=light.dtype, device=light.device)
    linear = torch.einsum("prw,wc->prc", turn, light[:3])
    a, b, xy, yz, zx = light[3:]
    rows = [a, 0.5 * xy, 0.5 * zx, 0.5 * xy, b, 0.5 * yz, 0.5 * zx, 0.5 * yz, -a - b]
    form = torch.einsum("prw,wvc,pqv->prqc", turn, torch.stack(rows).unflatten(0, (3, 3)), turn)
    squares = [form[:, axis, axis] for axis in range(3)]
    mixed = [2.0 * form[:, axis, (axis + 1) % 3] for axis in range(3)]
    return torch.cat([linear, torch.stack(squares + mixed, dim=1)], dim=1)

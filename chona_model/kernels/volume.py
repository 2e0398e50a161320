"""The seam for volume integration over packed candidates."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.cpu import integrate as cpu
from chona_model.kernels.grid import fast


class _Integrate(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        density: Tensor,
        rgb: Tensor,
        first: Tensor,
        depth: Tensor,
        delta: Tensor,
        is_object: Tensor,
        stop: float,
    ) -> tuple[Tensor, Tensor]:
        out, weights = torch.empty(len(first) - 1, 6), torch.empty_like(density)
        density, rgb = density.contiguous(), rgb.contiguous()
        cpu.integrate(
            first.numpy(), depth.numpy(), delta.numpy(), density.numpy(), rgb.numpy(), is_object.numpy(),
            np.float32(stop), out.numpy(), weights.numpy(),
        )  # fmt: skip
        ctx.save_for_backward(density, rgb, first, depth, delta, is_object, weights)
        ctx.stop = np.float32(stop)
        ctx.mark_non_differentiable(weights)
        return out, weights

    @staticmethod
    def backward(ctx: Any, grad_out: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        density, rgb, first, depth, delta, is_object, weights = ctx.saved_tensors
        grad_density, grad_rgb = torch.zeros_like(density), torch.zeros_like(rgb)
        cpu.integrate_backward(
            first.numpy(), depth.numpy(), delta.numpy(), density.numpy(), rgb.numpy(), is_object.numpy(),
            weights.numpy(), ctx.stop, grad_out.contiguous().numpy(), grad_density.numpy(), grad_rgb.numpy(),
        )  # fmt: skip
        return grad_density, grad_rgb, None, None, None, None, None


def integrate(
    density: Tensor, rgb: Tensor, first: Tensor, depth: Tensor, delta: Tensor, is_object: Tensor, stop: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Composites candidates front to back (see ``kernels.cpu.integrate``).

    Args:
        density: [M] 1/m; rgb: [M, 3]; depth, delta: [M] metres; is_object: [M] bool.
        first: [R + 1] int64 first candidate of each ray.
        stop: transmittance at which a ray ends.

    Returns:
        [R, 6] premultiplied rgb, alpha, Σ w·depth, Σ w over objects; and [M] weights (no gradient).
    """
    if fast(density):
        out, weights = _Integrate.apply(density, rgb, first, depth, delta, is_object, stop)
        return out, weights
    return reference.integrate(density, rgb, first, depth, delta, is_object, stop)

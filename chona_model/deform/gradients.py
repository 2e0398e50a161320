"""Gradients through roots by the implicit function theorem.

Root finding runs without a graph.  At a root f(x_c; θ) = x_p, so  dx_c = J⁻¹ (dx_p - ∂f/∂θ dθ):  whatever gradient
arrives at x_c is passed, multiplied by -J⁻ᵀ, to the residual f(x_c; θ) - x_p, evaluated once with a graph.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from chona_model.geometry import inverse_3x3


class _ImplicitRoot(torch.autograd.Function):
    @staticmethod
    def forward(  # the residual is there for its gradient alone
        ctx: Any,
        root: Tensor,
        residual: Tensor,  # noqa: ARG004
        inverse: Tensor,
        usable: Tensor,
    ) -> Tensor:
        ctx.save_for_backward(inverse, usable)
        return root.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[None, Tensor, None, None]:
        inverse, usable = ctx.saved_tensors
        passed = -(inverse.transpose(-1, -2) @ grad[..., None])[..., 0]
        return None, torch.where(usable[..., None], passed, 0.0), None, None


def attach_implicit_gradients(
    root: Tensor, posed: Tensor, targets: Tensor, jacobians: Tensor, usable: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Makes roots differentiable by everything their forward map depends on; their values do not change.

    Args:
        root: [M, 3] canonical points found without a graph.
        posed: [M, 3] the forward map at ``root.detach()``, with a graph to its parameters, transforms and codes.
        targets: [M, 3] posed points that were inverted; may carry a graph.
        jacobians: [M, 3, 3] ∂posed/∂root.
        usable: [M] bool, rows that converged; others pass no gradient.

    Returns:
        roots [M, 3] with a graph, and the rows [M] bool that pass gradients: usable and with a Jacobian that is not
        near singular (there the true gradient is unbounded, and one such row would outweigh a whole batch).
    """
    inverse = inverse_3x3(jacobians.detach())
    passing = inverse.regular if usable is None else inverse.regular & usable
    attached: Tensor = _ImplicitRoot.apply(root.detach(), posed - targets, inverse.matrix, passing)
    return attached, passing

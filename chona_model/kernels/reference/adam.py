"""Adam on grid tables that touches only rows with a gradient, plain torch."""

from __future__ import annotations

import torch
from torch import Tensor


@torch.no_grad()
def adam_rows(
    table: Tensor,
    grad: Tensor,
    mean: Tensor,
    square: Tensor,
    rate: float,
    beta1: float,
    beta2: float,
    epsilon: float,
    correction1: float,
    correction2: float,
) -> None:
    """One step in place; rows whose gradient is all zero stay as they are, and the gradient is cleared.

    Args:
        table, grad, mean, square: [rows, F] parameters, gradient, and its running first and second moments.
        rate: learning rate; beta1, beta2: decay of the moments; epsilon: keeps the quotient finite.
        correction1, correction2: 1 − βᵗ of the step.
    """
    rows = (grad != 0).any(dim=1).nonzero().squeeze(1)
    g = grad[rows]
    m = beta1 * mean[rows] + (1.0 - beta1) * g
    v = beta2 * square[rows] + (1.0 - beta2) * g * g
    mean[rows], square[rows] = m, v
    table[rows] -= rate * (m / correction1) / ((v / correction2).sqrt() + epsilon)
    grad.zero_()

"""Adam on grid tables that touches only rows with a gradient, and clears the gradient in the same pass."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(parallel=True, fastmath=True, cache=True)
def adam_rows(table, grad, mean, square, rate, beta1, beta2, epsilon, correction1, correction2):
    """One step on [rows, FEATURES]; rows whose gradient is all zero stay as they are (as in instant-NGP).

    Args:
        rate: learning rate; correction1, correction2: 1 − βᵗ of the step.
    """
    one = np.float32(1.0)
    for r in prange(len(table)):
        touched = False
        for k in range(table.shape[1]):
            touched |= grad[r, k] != 0.0
        if touched:
            for k in range(table.shape[1]):
                g = grad[r, k]
                m = beta1 * mean[r, k] + (one - beta1) * g
                v = beta2 * square[r, k] + (one - beta2) * g * g
                mean[r, k], square[r, k] = m, v
                table[r, k] -= rate * (m / correction1) / (np.sqrt(v / correction2) + epsilon)
                grad[r, k] = np.float32(0.0)

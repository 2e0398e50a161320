"""Adam on grid tables that visits only rows with a gradient, and clears the gradient in the same pass."""

from __future__ import annotations

import numpy as np

from chona_model.kernels.cpu.jit import entry


@entry
def adam_rows(
    begin, end, table, grad, mean, square, touched, rate, beta1, beta2, epsilon, correction1, correction2
):  # fmt: skip
    """One step on the rows ``begin`` to ``end`` of [rows, FEATURES]; the others' moments rest (as in instant-NGP).

    Args:
        touched: [rows] uint8, which rows have a gradient; cleared.
        rate: learning rate; correction1, correction2: 1 − βᵗ of the step.
    """
    one = np.float32(1.0)
    for r in range(begin, end):
        if touched[r]:
            touched[r] = 0
            for k in range(table.shape[1]):
                g = grad[r, k]
                m = beta1 * mean[r, k] + (one - beta1) * g
                v = beta2 * square[r, k] + (one - beta2) * g * g
                mean[r, k], square[r, k] = m, v
                table[r, k] -= rate * (m / correction1) / (np.sqrt(v / correction2) + epsilon)
                grad[r, k] = np.float32(0.0)

"""Broyden's method as inverse skinning is usually solved (SNARF, TAVA), written from its textbook form: a reference.

"Good" Broyden: the inverse Jacobian is exact at the start, then only corrected by rank-one updates (Sherman and
Morrison), so a step costs a forward evaluation and no derivative.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from chona_model.deform.inverse import Warp

STEPS = 50
"""Evaluations after the first, at most: what SNARF and TAVA allow."""

CONVERGED = 1e-5
"""Residual that ends the search, metres."""

DIVERGED = 1.0
"""Residual at which a row is given up, metres."""

SMALLEST = 1e-6
"""Kept between a rank-one update's denominator and zero."""


@dataclass(frozen=True)
class Found:
    """Best points [A, 3], their residuals [A] metres, and the evaluations of each row [A]."""

    points: Tensor
    residuals: Tensor
    evaluations: Tensor

    @property
    def converged(self) -> Tensor:
        """[A] bool."""
        return self.residuals < CONVERGED


@torch.no_grad()
def solve(warp: Warp, targets: Tensor, starts: Tensor, rows_at_once: int = 2**15) -> Found:
    """Solves warp(x) = target for every row.

    Args:
        warp: forward map with its Jacobian, which is used at the starts alone.
        targets: [M, 3]; starts: [M, K, 3]: M · K rows, ``rows_at_once`` together.

    Returns:
        Found for the M · K rows in order.
    """
    count = starts.shape[1]
    rows = torch.arange(len(targets)).repeat_interleave(count)
    parts = [_solve(warp, targets, x, r) for x, r in zip(
        starts.reshape(-1, 3).split(rows_at_once), rows.split(rows_at_once), strict=True
    )]  # fmt: skip
    return Found(*(torch.cat([getattr(part, name) for part in parts]) for name in Found.__annotations__))


def _solve(warp: Warp, targets: Tensor, starts: Tensor, rows: Tensor) -> Found:
    posed, jacobian = warp(starts, rows)
    inverse = torch.linalg.inv_ex(jacobian).inverse
    error = posed - targets[rows]
    x, best, residual = starts.clone(), starts.clone(), torch.linalg.vector_norm(error, dim=-1)
    evaluations = torch.ones_like(rows)
    active = torch.arange(len(x))
    for _ in range(STEPS):
        if len(active) == 0:
            break
        step = -(inverse @ error[..., None])[..., 0]
        x[active] += step
        new = warp(x[active], rows[active])[0] - targets[rows[active]]
        length = torch.linalg.vector_norm(new, dim=-1)
        evaluations[active] += 1
        better = length < residual[active]
        best[active[better]], residual[active[better]] = x[active[better]], length[better]
        keep = (residual[active] > CONVERGED) & (length < DIVERGED)
        change = new - error
        along = (step[:, None] @ inverse)[:, 0]  # stepᵀ J⁻¹
        scale = (along * change).sum(dim=-1)
        scale = torch.where(scale >= 0, scale + SMALLEST, scale - SMALLEST)
        missed = step - (inverse @ change[..., None])[..., 0]
        inverse = inverse + (missed / scale[:, None])[..., None] * along[:, None]
        active, error, inverse = active[keep], new[keep], inverse[keep]
    return Found(best, residual, evaluations)

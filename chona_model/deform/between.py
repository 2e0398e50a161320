"""A second look for roots that lie between those the nearest bones lead to.

Where a pose folds space over, a posed point has several canonical ones, and det J has one sign on each side of a fold:
two roots with det J > 0 have one with det J < 0 between them, which no bone's start leads to.  So the signs of the
roots found say which targets to look at again, and the roots themselves say where.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import torch
from torch import Tensor

from chona_model.deform.inverse import MERGE_RADIUS, Roots, Warp, find_roots, first_of_equals
from chona_model.settings import InverseSettings

NEAREST = 3
"""Starts, the nearest first, between whose roots is looked."""


@torch.no_grad()
def doubtful(roots: Roots, usable: Tensor) -> Tensor:
    """[M] bool: the roots' signs do not add up, or one of the two nearest starts got stuck.

    Args:
        usable: [M, K] bool, the starts that were followed.
    """
    signs = torch.sign(torch.linalg.det(roots.jacobians)) * roots.distinct
    stuck = (usable & ~roots.converged)[:, :2].any(dim=-1)
    return (signs.sum(dim=-1) > 1) | stuck


@torch.no_grad()
def look_between(
    warp: Warp,
    targets: Tensor,
    starts: Tensor,
    usable: Tensor,
    roots: Roots,
    *,
    size: float,
    settings: InverseSettings,
    rows_at_once: int | None = None,
) -> Roots:
    """Starts once more from the middles of what was found, for targets that seem to miss a root.

    Args:
        warp, targets, starts, usable, size, settings, rows_at_once: as ``find_roots`` had them, nearest starts first.
        roots: what it gave.

    Returns:
        Roots with more columns: those there were, then one for each pair of the first ``NEAREST`` and one for the mean
        of their starts; not followed for targets that are not doubtful.
    """
    again = doubtful(roots, usable).nonzero()[:, 0]
    first = min(NEAREST, starts.shape[1])
    pairs = list(combinations(range(first), 2))
    places = [0.5 * (roots.points[again, i] + roots.points[again, j]) for i, j in pairs]
    followed = [usable[again, i] & usable[again, j] for i, j in pairs]
    mean = _mean(starts[again, :first], usable[again, :first])
    middles, follow = torch.stack([*places, mean], dim=1), torch.stack([*followed, usable[again, 0]], dim=1)
    found = find_roots(
        lambda x, rows: warp(x, again[rows]), targets[again], middles, first_of_equals(middles, follow, 0.0),
        size=size, settings=settings, rows_at_once=rows_at_once,
    )  # fmt: skip
    count, columns = len(targets), middles.shape[1]

    def joined(name: str, blank: Tensor) -> Tensor:
        later = blank.expand(count, columns, *blank.shape).clone()
        later[again] = getattr(found, name)
        return torch.cat([getattr(roots, name), later], dim=1)

    points = joined("points", targets.new_zeros(3))
    converged = joined("converged", usable.new_zeros(()))
    return replace(
        roots,
        points=points,
        jacobians=joined("jacobians", torch.eye(3, dtype=targets.dtype, device=targets.device)),
        residuals=joined("residuals", targets.new_full((), torch.inf)),
        converged=converged,
        distinct=first_of_equals(points, converged, MERGE_RADIUS * size),
        iterations=joined("iterations", roots.iterations.new_zeros(())),
    )


def _mean(points: Tensor, usable: Tensor) -> Tensor:
    """Means [M, 3] of the usable ones of points [M, K, 3]."""
    share = usable.to(points.dtype)[..., None]
    return (torch.where(usable[..., None], points, 0.0)).sum(dim=1) / share.sum(dim=1).clamp(min=1.0)

"""Inverse skinning: the canonical points that a posed point may come from, by Newton's method from several starts.

Every start is a row of its own with its own step length, and leaves the batch as soon as it converged or is given up.
Nothing is repaired: a row that fails keeps its best point and says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from chona_model.figure import PoseBatch
from chona_model.geometry import box_distances, inverse_3x3, segment_distances
from chona_model.settings import InverseSettings

Warp = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""(canonical points [A, 3], target of each [A] int64) → (posed points [A, 3], Jacobians [A, 3, 3])."""

STEP_LIMIT = 0.2
"""Longest Newton step as a share of the figure's size: near singular Jacobians point far away.  A shorter limit saves a
tenth of the evaluations on trained weights, and loses roots far from every start while the weights are still random."""

SMALLEST_SHARE = 2.0**-8
"""A row whose residual does not fall even by this share of its Newton step sits in a local minimum: given up."""

SUFFICIENT_DECREASE = 0.1
"""A step of share s must lower the residual by this fraction of s (Armijo's condition)."""

MERGE_RADIUS = 1e-4
"""Roots nearer than this share of the figure's size are one."""

SAME_START = 1e-6
"""Starts nearer than this share of the figure's size lead to the same root: only the first is followed."""

CPU_ROWS, GPU_ROWS = 6144, 2**18
"""Rows evaluated together: smaller products waste a core's vector units, larger ones memory."""


@dataclass(frozen=True)
class Roots:
    """What root finding gives for M targets with K starts each.

    Attributes:
        points: [M, K, 3] best canonical points found.
        jacobians: [M, K, 3, 3] ∂x_p/∂x_c there.
        residuals: [M, K] metres; infinite for starts that were not followed.
        converged: [M, K] bool, residual within tolerance.
        distinct: [M, K] bool, converged and not within ``MERGE_RADIUS`` of an earlier one.
        iterations: [M, K] int64 evaluations spent.
        empty: [M] bool, known without a root: everything that could be there is out of reach.
    """

    points: Tensor
    jacobians: Tensor
    residuals: Tensor
    converged: Tensor
    distinct: Tensor
    iterations: Tensor
    empty: Tensor

    @property
    def found(self) -> Tensor:
        """[M] bool: at least one root converged, or none is needed."""
        return self.converged.any(dim=-1) | self.empty


@torch.no_grad()
def bone_distances(targets: Tensor, poses: PoseBatch, index: Tensor, object_boxes: Tensor) -> tuple[Tensor, Tensor]:
    """Where every bone says a posed point comes from, and how far that is from the bone.

    Rigid maps keep lengths, so the distance to a posed bone is that of T_j⁻¹ x_p to its canonical segment (an object's:
    to its canonical box).

    Args:
        targets: [M, 3] root space; index: [M] pose of each; object_boxes: [P, N, 2, 3] corners in canonical space.

    Returns:
        T_j⁻¹ x_p [M, J, 3] and distances [M, J], metres; infinite for absent bones.
    """
    rotation, offset = poses.transforms[..., :3, :3], poses.transforms[..., :3, 3]
    heads, tails, present = poses.heads, poses.tails, poses.present
    boxes = object_boxes
    if len(rotation) > 1:
        rotation, offset, heads, tails, present, boxes = (
            part.index_select(0, index) for part in (rotation, offset, heads, tails, present, boxes)
        )
    local = ((targets[:, None, :] - offset)[..., None, :] @ rotation)[..., 0, :]
    return local, canonical_distances(local, heads, tails, boxes, present)


def canonical_distances(points: Tensor, heads: Tensor, tails: Tensor, boxes: Tensor, present: Tensor) -> Tensor:
    """Distances [M, J] to every canonical bone and object box, metres; infinite for absent ones.

    Args:
        points: [M, J, 3], one for each bone and box.
        heads, tails: [M or 1, B, 3]; boxes: [M or 1, N, 2, 3]; present: [M or 1, J].
    """
    bones = heads.shape[1]
    distance = torch.cat(
        [
            segment_distances(points[:, :bones], heads, tails),
            box_distances(points[:, bones:], boxes[..., 0, :], boxes[..., 1, :]),
        ],
        dim=-1,
    )
    return torch.where(present, distance, torch.inf)


@torch.no_grad()
def bone_starts(
    targets: Tensor,
    poses: PoseBatch,
    index: Tensor,
    *,
    count: int,
    object_boxes: Tensor,
    background: bool = True,
    size: float = 1.0,
) -> tuple[Tensor, Tensor]:
    """Starts T_j⁻¹ x_p from the nearest bones in posed space, and x_p itself for the background.

    Args:
        targets: [M, 3] root space.
        index: [M] pose of each target.
        count: K nearest bones.
        object_boxes: [P, N, 2, 3] lower and upper corners in canonical space.
        size: of the figure, metres; starts that coincide within a share of it are followed once.

    Returns:
        starts [M, K', 3] and usable [M, K'] bool, K' = min(K, J) + background; unusable are starts of absent bones
        and repeated ones.
    """
    local, distance = bone_distances(targets, poses, index, object_boxes)
    nearest = torch.topk(distance, min(count, distance.shape[1]), dim=-1, largest=False, sorted=True)
    starts = torch.gather(local, 1, nearest.indices[..., None].expand(-1, -1, 3))
    usable = torch.isfinite(nearest.values)
    if background:
        starts = torch.cat([starts, targets[:, None, :]], dim=1)
        usable = torch.cat([usable, torch.isfinite(targets).all(dim=-1, keepdim=True)], dim=1)
    return starts, first_of_equals(starts, usable, SAME_START * size)


def first_of_equals(points: Tensor, usable: Tensor, radius: float) -> Tensor:
    """[M, K] bool: usable and no earlier usable point of the row lies within ``radius``."""
    first = usable.clone()
    for later in range(1, points.shape[1]):
        near = (points[:, :later] - points[:, later : later + 1]).square().sum(dim=-1) <= radius**2
        first[:, later] &= ~(near & first[:, :later]).any(dim=-1)
    return first


@torch.no_grad()
def find_roots(
    warp: Warp,
    targets: Tensor,
    starts: Tensor,
    usable: Tensor,
    *,
    size: float,
    settings: InverseSettings,
    rows_at_once: int | None = None,
) -> Roots:
    """Solves warp(x_c) = x_p by damped Newton steps.

    Args:
        warp: forward map with its Jacobian.
        targets: [M, 3] posed points x_p.
        starts: [M, K, 3]; usable: [M, K] bool, rows to follow.
        size: of the figure, metres: tolerance, divergence and step limit are shares of it.
        rows_at_once: how many of the M K rows are evaluated together; by default ``CPU_ROWS``, or ``GPU_ROWS`` on a
            GPU.  Rows do not see each other, so this changes memory and speed only.

    Returns:
        Roots; a target or start that is not finite never converges.
    """
    count, per_target = starts.shape[:2]
    if rows_at_once is None:
        rows_at_once = CPU_ROWS if starts.device.type == "cpu" else GPU_ROWS
    best = starts.reshape(-1, 3).clone()
    jacobians = torch.eye(3, dtype=best.dtype, device=best.device).repeat(len(best), 1, 1)
    residuals = best.new_full((len(best),), torch.inf)
    iterations = torch.zeros(len(best), dtype=torch.int64, device=best.device)
    rows = usable.reshape(-1).nonzero()[:, 0]
    target_rows = torch.div(rows, per_target, rounding_mode="floor")
    found = _follow(_in_parts(warp, rows_at_once), targets, target_rows, best[rows], size=size, settings=settings)
    best[rows], jacobians[rows], residuals[rows], iterations[rows] = found
    shape = (count, per_target)
    points, residuals = best.view(*shape, 3), residuals.view(shape)
    converged = residuals <= settings.tolerance * size
    return Roots(
        points=points,
        jacobians=jacobians.view(*shape, 3, 3),
        residuals=residuals,
        converged=converged,
        distinct=first_of_equals(points, converged, MERGE_RADIUS * size),
        iterations=iterations.view(shape),
        empty=torch.zeros_like(usable[:, 0]),
    )


def _in_parts(warp: Warp, rows_at_once: int) -> Warp:
    """The same map, evaluated at so many rows at a time."""

    def parts(x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        if len(x) <= rows_at_once:
            return warp(x, rows)
        done = [warp(*part) for part in zip(x.split(rows_at_once), rows.split(rows_at_once), strict=True)]
        return torch.cat([posed for posed, _ in done]), torch.cat([jacobian for _, jacobian in done])

    return parts


def _follow(
    warp: Warp, targets: Tensor, target_rows: Tensor, starts: Tensor, *, size: float, settings: InverseSettings
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Newton from one start [A, 3] a row: best points, Jacobians and residuals there, evaluations spent."""
    tolerance, limit = settings.tolerance * size, STEP_LIMIT * size
    best = starts.clone()
    jacobians = torch.eye(3, dtype=best.dtype, device=best.device).repeat(len(best), 1, 1)
    residuals = best.new_full((len(best),), torch.inf)
    iterations = torch.zeros(len(best), dtype=torch.int64, device=best.device)
    rows, trial = torch.arange(len(best), device=best.device), best
    step = torch.zeros_like(trial)
    share = torch.ones_like(trial[:, 0])
    for number in range(settings.steps + 1):
        if len(rows) == 0:
            break
        own = target_rows[rows]
        posed, jacobian = warp(trial, own)
        error = posed - targets[own]
        length = torch.linalg.vector_norm(error, dim=-1)
        iterations[rows] += 1
        # Comparisons with NaN are False: a trial that is not finite is never accepted.
        if number == 0:
            accepted = length <= settings.divergence * size
            fine = accepted
        else:
            accepted = length <= (1.0 - SUFFICIENT_DECREASE * share) * residuals[rows]
            fine = torch.ones_like(accepted)
        better = rows[accepted]
        best[better], jacobians[better], residuals[better] = trial[accepted], jacobian[accepted], length[accepted]
        newton = -(inverse_3x3(jacobian).matrix @ error[..., None])[..., 0]
        shrink = torch.clamp(limit / torch.linalg.vector_norm(newton, dim=-1).clamp(min=1e-30), max=1.0)
        step = torch.where(accepted[:, None], newton * shrink[:, None], step)
        share = torch.where(accepted, 1.0, 0.5 * share)
        keep = fine & ~(residuals[rows] <= tolerance) & (share >= SMALLEST_SHARE)
        rows, step, share = rows[keep], step[keep], share[keep]
        trial = best[rows] + share[:, None] * step
    return best, jacobians, residuals, iterations

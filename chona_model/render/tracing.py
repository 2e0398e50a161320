"""Rays through a grid model in stages, each over all rays at once: march, invert, prune, evaluate, integrate.

Plain tensors on any device, in any floating type, differentiable: what a GPU runs, and what ``grid_view`` and
``grid_trace``, which do the same ray by ray in the processor's cache, are compared with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels import marching, reference
from chona_model.kernels.volume import integrate
from chona_model.kernels.warp import NewtonLimits, VolumeIndex, invert
from chona_model.render.normals import surface_normals
from chona_model.render.occupancy import Occupancy
from chona_model.render.posed import POSED_CELL, PosedPart

APART = 0.01
"""Roots of one sample nearer than this are one, metres."""


@dataclass(frozen=True)
class TraceSettings:
    """Shortcuts of tracing.

    Attributes:
        step: distance between samples, metres.
        newton: limits of the voxel root finder.
        accept: residual up to which a root counts, metres.
        trust: share of cached densities that counts when deciding what is hidden.
        stop: transmittance behind which nothing is evaluated; 0 evaluates everything.
    """

    step: float = 0.01
    newton: NewtonLimits = NewtonLimits()
    accept: float = 0.002
    trust: float = 0.5
    stop: float = 1e-3


@dataclass(frozen=True)
class PoseTable:
    """P poses as the stages take them, on one device; rays name them by index.

    Attributes:
        parts: posed cells of each pose, on the host.
        grids, slots, occupancy: start grids, objects and occupancy of all parts.
        centres: [V, 3] canonical points that ``grids`` point to; persons: [P] int32 part of each pose's person or −1.
        normals: [cells, 3] of all parts.
    """

    parts: tuple[PosedPart, ...]
    grids: marching.StartGrids[Tensor]
    slots: marching.Slots[Tensor]
    occupancy: marching.Occupancy[Tensor]
    centres: Tensor
    persons: Tensor
    normals: Tensor


def make_pose_table(
    model: GridModel, poses: Sequence[PosedFigure], occupancy: Occupancy | None = None,
    normals: np.ndarray | None = None, parts: Sequence[PosedPart] | None = None,
) -> PoseTable:  # fmt: skip
    """Poses on the model's device, in its floating type.

    Args:
        occupancy: which cells to sample; the model's own where none is given.
        normals, parts: where they are known already.
    """
    occupancy = occupancy or model.occupancy
    if parts is None:
        cells = model.cells(occupancy)
        parts = [model.pose_cells(pose, cells) for pose in poses]
    voxels = np.concatenate([[0], np.cumsum([len(part.centres) for part in parts])])
    starts = np.concatenate(
        [np.where(part.starts >= 0, part.starts + voxels[index], -1) for index, part in enumerate(parts)]
    )
    slot_part = np.stack([model.slot_parts(pose) for pose in poses])
    slots = np.stack([pose.slots for pose in poses]).reshape(len(poses), model.shape.object_slots, 3, 4)
    real = model.real

    def whole(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, device=model.device)

    first = np.concatenate([[0], np.cumsum([len(part.starts) for part in parts])])[:-1]
    return PoseTable(
        tuple(parts),
        marching.StartGrids(
            whole(starts.astype(np.int32)), whole(first), whole(np.stack([part.dims for part in parts])),
            real(np.stack([part.origin for part in parts])), 1 / POSED_CELL,
        ),
        marching.Slots(whole(slot_part), real(slots)),
        marching.Occupancy(
            real(occupancy.densities), whole(occupancy.first[:-1]), whole(occupancy.dims), real(occupancy.origins),
            1 / occupancy.cell,
        ),
        real(np.concatenate([part.centres for part in parts])),
        whole(np.array([pose.person for pose in poses], dtype=np.int32)),
        real(surface_normals(model.occupancy) if normals is None else normals),
    )  # fmt: skip


@dataclass(frozen=True)
class RayRows:
    """R rays: origins and directions [R, 3] in root space, near and far depths [R], jitter [R] in 0…1, pose [R] int32
    in the table, pair [R, 1 + N] int64 rows of the identity pairs: for the person, and for each slot's object."""

    origins: Tensor
    directions: Tensor
    near: Tensor
    far: Tensor
    jitter: Tensor
    pose: Tensor
    pair: Tensor


@dataclass(frozen=True)
class Found:
    """Samples that were evaluated: ray [M], depth [M] metres, density [M] 1/m, rgb [M, 3], thing [M] bool, slot [M] of
    those on objects, −1 of others; their weight [M] in the picture; and where asked for, normal [M, 3] in root space,
    of length one or zero."""

    ray: Tensor
    depth: Tensor
    density: Tensor
    rgb: Tensor
    thing: Tensor
    slot: Tensor
    weight: Tensor
    normal: Tensor | None


@dataclass(frozen=True)
class Traced:
    """Result of tracing R rays.

    Attributes:
        found: the samples.
        out: [R, 6] premultiplied rgb, alpha, Σ w·depth, Σ w over objects.
        failed: [R] body candidates whose root finding failed; tried: [R] all body candidates.
        evaluated: how often the field was.
    """

    found: Found
    out: Tensor
    failed: Tensor
    tried: Tensor
    evaluated: int


def trace(
    model: GridModel, table: PoseTable, matrices: Tensor, index: VolumeIndex, rays: RayRows, pairs: Tensor,
    codes: Tensor | None, lights: Tensor, settings: TraceSettings, facing: bool = False,
) -> Traced:  # fmt: skip
    """Traces rays; differentiable in the field, the matrices and the lights.

    Args:
        matrices, index: from ``GridModel.matrices`` for the table's poses.
        pairs: [Q, 2] identity pairs; codes: [P, C] pose codes, or None for no occlusion.
        lights: [P, 9, 3] (see ``GridModel.root_light``).
        facing: whether normals are wanted.
    """
    found: marching.Candidates[Tensor] = marching.march(
        rays.origins, rays.directions, rays.near, rays.far, rays.jitter, rays.pose, settings.step, table.grids,
        table.slots, table.occupancy,
    )  # fmt: skip
    ray, kind = found.ray.long(), found.kind
    pose = rays.pose[ray].long()
    body = (kind < 0).nonzero()[:, 0]
    part = torch.where(kind < 0, table.persons[pose], table.slots.part[pose, kind.long().clamp(min=0)])
    points, failed = found.points, torch.zeros(len(kind), dtype=torch.bool, device=kind.device)
    if len(body):
        roots, residuals = invert(
            matrices, points[body], table.centres[found.voxel[body].long()], pose[body].int(), index, settings.newton
        )
        points = points.index_put((body,), roots)
        failed = failed.index_put((body,), residuals > settings.accept)
    keep = marching.prune(
        found.first, found.depth, points.detach(), part, failed, settings.step, settings.trust, settings.stop, APART,
        table.occupancy,
    )  # fmt: skip
    kept = torch.as_tensor(keep)
    chosen = kept.nonzero()[:, 0]
    first = torch.nn.functional.pad(kept.long().cumsum(dim=0), (1, 0))[found.first]
    points, part, kind, ray, pose = points[chosen], part[chosen], kind[chosen], ray[chosen], pose[chosen]
    density, rgb = model.field(points, part, pairs, rays.pair[ray, kind.long() + 1], codes, pose)
    normals = _root_normals(table, matrices.detach(), index, points.detach(), part, kind, pose)
    rgb = rgb * reference.gains(normals, lights[pose])
    depth = found.depth[chosen]
    out, weight = integrate(
        density, rgb, first, depth, torch.full_like(depth, settings.step), kind >= 0, settings.stop * 0.1
    )
    count = len(rays.near)
    body_ray = found.ray[body].long()
    tried = torch.bincount(body_ray, minlength=count)
    facings = _facings(table, matrices.detach(), index, points.detach(), part, kind, pose) if facing else None
    found_samples = Found(ray, depth, density, rgb, kind >= 0, kind, weight, facings)
    return Traced(found_samples, out, torch.bincount(body_ray[failed[body]], minlength=count), tried, len(chosen))


def _root_normals(
    table: PoseTable, matrices: Tensor, index: VolumeIndex, points: Tensor, part: Tensor, kind: Tensor, pose: Tensor
) -> Tensor:
    """Root-space normals [M, 3] of candidates: turned with the blended matrix, or with their object."""
    body = (kind < 0).nonzero()[:, 0]
    return _turned(
        table, points, part, kind, pose, body, reference.blended_rotations(matrices, points[body], pose[body], index)
    )


def _facings(
    table: PoseTable, matrices: Tensor, index: VolumeIndex, points: Tensor, part: Tensor, kind: Tensor, pose: Tensor
) -> Tensor:
    """The same normals taken through the whole warp, at length one or zero (see ``kernels.cpu.face``)."""
    body = (kind < 0).nonzero()[:, 0]
    first, second, third = reference.warp(matrices, points[body], pose[body], index)[1].unbind(dim=-2)
    rows = [torch.linalg.cross(second, third), torch.linalg.cross(third, first), torch.linalg.cross(first, second)]
    normals = _turned(table, points, part, kind, pose, body, torch.stack(rows, dim=-2))
    square = normals.square().sum(dim=-1, keepdim=True)
    return torch.where(square > reference.FAINT, normals * square.clamp(min=reference.FAINT).rsqrt(), 0.0)


def _turned(
    table: PoseTable, points: Tensor, part: Tensor, kind: Tensor, pose: Tensor, body: Tensor, turns: Tensor
) -> Tensor:
    """Normals [M, 3] of candidates in root space, those on the ``body`` [B] turned by matrices [B, 3, 3]."""
    grids = table.occupancy
    normals = reference.normals_at(
        points, part, table.normals, grids.first, grids.dims, grids.origins, grids.inverse_cell
    )
    turned = table.slots.matrix[pose, kind.long().clamp(min=0), :, :3].transpose(-1, -2)
    return (turned.index_put((body,), turns) @ normals[..., None])[..., 0]

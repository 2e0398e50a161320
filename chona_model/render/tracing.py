"""Rays through a grid model: march, invert, prune, evaluate, integrate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels import reference
from chona_model.kernels.cpu import march as kernel
from chona_model.kernels.volume import integrate
from chona_model.kernels.warp import NewtonLimits, VolumeIndex, invert
from chona_model.render.normals import surface_normals
from chona_model.render.occupancy import Occupancy
from chona_model.render.posed import POSED_CELL, PosedPart


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
    """Poses concatenated for the marching kernel; rays name them by index."""

    occupancy: Occupancy
    normals: np.ndarray
    poses: tuple[PosedFigure, ...]
    parts: tuple[PosedPart, ...]
    starts: np.ndarray
    first: np.ndarray
    dims: np.ndarray
    origins: np.ndarray
    centres: np.ndarray
    slot_part: np.ndarray
    slot_matrix: np.ndarray


def make_pose_table(model: GridModel, poses: Sequence[PosedFigure], occupancy: Occupancy | None = None) -> PoseTable:
    """Builds posed start grids from an occupancy as it is now; the model's own where none is given."""
    occupancy = occupancy or model.occupancy
    cells = model.cells(occupancy)
    parts = [model.pose_cells(pose, cells) for pose in poses]
    voxels = np.concatenate([[0], np.cumsum([len(part.centres) for part in parts])])
    starts = np.concatenate(
        [np.where(part.starts >= 0, part.starts + voxels[index], -1) for index, part in enumerate(parts)]
    )
    slot_part = np.full((len(poses), model.shape.object_slots), -1, dtype=np.int32)
    for index, pose in enumerate(poses):
        for slot, thing in enumerate(pose.objects):
            slot_part[index, slot] = len(model.persons) + thing
    return PoseTable(
        occupancy, surface_normals(model.occupancy), tuple(poses), tuple(parts), starts.astype(np.int32),
        np.concatenate([[0], np.cumsum([len(part.starts) for part in parts])]),
        np.stack([part.dims for part in parts]),
        np.stack([part.origin for part in parts]).astype(np.float32),
        np.concatenate([part.centres for part in parts]),
        slot_part,
        np.stack([pose.slots for pose in poses]).reshape(len(poses), model.shape.object_slots, 3, 4),
    )  # fmt: skip


@dataclass(frozen=True)
class Traced:
    """Result of tracing R rays.

    Attributes:
        out: [R, 6] premultiplied rgb, alpha, Σ w·depth, Σ w over objects.
        weights: [M] of the evaluated candidates; ray: [M] their rays.
        failed: [R] body candidates whose root finding failed; tried: [R] all body candidates.
        evaluated: M.
    """

    out: Tensor
    weights: Tensor
    ray: Tensor
    failed: np.ndarray
    tried: np.ndarray
    evaluated: int


def trace(
    model: GridModel, table: PoseTable, matrices: Tensor, index: VolumeIndex, local_pose: np.ndarray,
    rays: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], pose: np.ndarray, jitter: np.ndarray,
    pairs: Tensor, ray_pair: Tensor, codes: Tensor | None, lights: Tensor, settings: TraceSettings,
) -> Traced:  # fmt: skip
    """Traces rays; differentiable in the field and in the matrices.

    Args:
        table: poses that ``pose`` [R] int32 indexes; local_pose: [len(table)] int32 index of each in ``matrices``.
        matrices, index: from ``GridModel.matrices`` for the poses in use.
        rays: origins [R, 3], directions [R, 3], near [R], far [R], float32, root space.
        jitter: [R] float32 in 0…1.
        pairs: [Q, 2] identity pairs; ray_pair: [R] int64.
        codes: [P, C] pose codes by local pose, or None; lights: [P, 9, 3] (see ``GridModel.root_light``).
    """
    origins, directions, near, far = rays
    occupancy = table.occupancy
    cells = (
        occupancy.densities,
        occupancy.first[:-1],
        occupancy.dims,
        occupancy.origins,
        np.float32(1 / occupancy.cell),
    )
    grids = (table.starts, table.first[:-1], table.dims, table.origins, np.float32(1 / POSED_CELL))
    first = np.zeros(len(origins) + 1, dtype=np.int64)
    none = np.zeros(0, dtype=np.int32)
    nothing = (none, np.zeros(0, dtype=np.float32), none, none, np.zeros((0, 3), dtype=np.float32))
    head = (origins, directions, near, far, jitter, pose, np.float32(settings.step), *grids, table.slot_part,
            table.slot_matrix, *cells, first)  # fmt: skip
    kernel.march(False, *head, *nothing)
    np.cumsum(first, out=first)
    count = int(first[-1])
    ray, kind, voxel = (np.empty(count, dtype=np.int32) for _ in range(3))
    depth, points = np.empty(count, dtype=np.float32), np.empty((count, 3), dtype=np.float32)
    kernel.march(True, *head, ray, depth, kind, voxel, points)

    body = np.flatnonzero(kind < 0)
    candidate_pose = pose[ray]
    part = np.empty(count, dtype=np.int32)
    persons = np.array([figure.person for figure in table.poses], dtype=np.int32)
    part[body] = persons[candidate_pose[body]]
    things = np.flatnonzero(kind >= 0)
    part[things] = table.slot_part[candidate_pose[things], kind[things]]
    failed = np.zeros(count, dtype=bool)
    roots = None
    if len(body):
        roots, residuals = invert(
            matrices, torch.from_numpy(points[body]), torch.from_numpy(table.centres[voxel[body]]),
            torch.from_numpy(local_pose[candidate_pose[body]]), index, settings.newton,
        )  # fmt: skip
        failed[body] = residuals.numpy() > settings.accept
        points[body] = roots.detach().numpy()
    keep = np.empty(count, dtype=bool)
    kernel.prune(
        first, depth, points, part, failed, np.float32(settings.step), np.float32(settings.trust),
        np.float32(settings.stop), np.float32(0.01), *cells, keep,
    )  # fmt: skip
    chosen = np.flatnonzero(keep)
    kept_first = np.concatenate([[0], np.cumsum(keep)])[first]
    local = torch.from_numpy(points[chosen])
    if roots is not None and roots.requires_grad:
        where = np.full(count, -1, dtype=np.int64)
        where[body] = np.arange(len(body))
        source = where[chosen]
        on_body = np.flatnonzero(source >= 0)
        local = local.index_put((torch.from_numpy(on_body),), roots[torch.from_numpy(source[on_body])])
    ray_kept = ray[chosen]
    ray_index = torch.from_numpy(ray_kept).long()
    density, rgb = model.field(
        local, torch.from_numpy(part[chosen]), pairs, ray_pair[ray_index], codes,
        torch.from_numpy(local_pose[pose[ray_kept]]).long(),
    )  # fmt: skip
    normals = _root_normals(table, matrices.detach(), index, local_pose, part, kind, pose[ray], points, chosen)
    rgb = rgb * reference.gains(normals, lights[torch.from_numpy(local_pose[pose[ray_kept]]).long()])
    out, weights = integrate(
        density, rgb, torch.from_numpy(kept_first), torch.from_numpy(depth[chosen]),
        torch.full((len(chosen),), settings.step), torch.from_numpy(kind[chosen] >= 0), settings.stop * 0.1,
    )  # fmt: skip
    tried = np.bincount(ray[body], minlength=len(origins))
    missed = np.bincount(ray[body], weights=failed[body], minlength=len(origins))
    return Traced(out, weights, ray_index, missed, tried, len(chosen))


def _root_normals(
    table: PoseTable, matrices: Tensor, index: VolumeIndex, local_pose: np.ndarray, part: np.ndarray, kind: np.ndarray,
    pose: np.ndarray, points: np.ndarray, chosen: np.ndarray,
) -> Tensor:  # fmt: skip
    """Root-space normals [M, 3] of the chosen candidates: turned with the blended matrix, or with their object."""
    occupancy = table.occupancy
    local, parts, kinds, poses = (torch.from_numpy(array[chosen]) for array in (points, part, kind, pose))
    first, dims, origins = (torch.from_numpy(array) for array in (occupancy.first, occupancy.dims, occupancy.origins))
    normals = reference.normals_at(
        local, parts, torch.from_numpy(table.normals), first, dims, origins, 1.0 / occupancy.cell
    )
    turned = torch.from_numpy(table.slot_matrix)[poses.long(), kinds.long().clamp(min=0), :, :3].transpose(-1, -2)
    body = kinds < 0
    own = torch.from_numpy(local_pose)[poses[body].long()]
    turned[body] = reference.blended_rotations(matrices, local[body], own, index)
    return (turned @ normals[..., None])[..., 0]

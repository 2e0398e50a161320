"""The seam for marching: which points of rays could hold anything, where to start their inversion, what to drop.

Arrays are numpy's or torch's, all of one kind in a call. numpy arrays and float32 tensors on the CPU go to the numba
kernels without a copy; other tensors to the torch twins. Results are of the kind, and on the device, of the input.
None of this carries gradients.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.cpu import march as kernels
from chona_model.kernels.cpu import posing
from chona_model.kernels.grid import fast
from chona_model.kernels.threads import in_pieces

BODY = kernels.BODY
cpu: Any = kernels  # numba compiles by the arguments it meets; their types are none a checker knows

SLAB = 24
"""Layers of a posed grid that a thread fills at once."""

BAND = 96
"""Rows of an image that a thread finds spans for at once."""

Array = np.ndarray | Tensor
A = TypeVar("A", np.ndarray, Tensor)


@dataclass(frozen=True)
class StartGrids(Generic[A]):
    """Posed start grids of P poses (see ``mark_starts``), concatenated.

    Attributes:
        starts: [cells, chances] int32 canonical voxels, −1 where there is none.
        first: [P] int64 begin of the pose's grid; dims: [P, 3] int64 cells along each axis.
        origins: [P, 3] float32 lower corner in root space, metres.
        inverse_cell: 1/m.
    """

    starts: A
    first: A
    dims: A
    origins: A
    inverse_cell: float


@dataclass(frozen=True)
class Occupancy(Generic[A]):
    """Grids of cached densities of all parts, concatenated.

    Attributes:
        densities: [cells] float32, 1/m; 0 means empty.
        first: [parts] int64 begin of the part's grid; dims: [parts, 3] int64 cells along each axis.
        origins: [parts, 3] float32 lower corner in the part's local frame, metres.
        inverse_cell: 1/m.
    """

    densities: A
    first: A
    dims: A
    origins: A
    inverse_cell: float


@dataclass(frozen=True)
class Slots(Generic[A]):
    """Objects of P poses.

    Attributes:
        part: [P, N] int32 part in each object slot, or −1.
        matrix: [P, N, 3, 4] float32 root space to the part's frame.
    """

    part: A
    matrix: A


@dataclass(frozen=True)
class Candidates(Generic[A]):
    """Points of rays that may hold something, in order of rays, depths, and the body before the objects.

    Attributes:
        first: [R + 1] int64 first candidate of each ray.
        ray: [M] int32; depth: [M] along the camera axis, metres.
        kind: [M] int32 ``BODY`` or the object's slot.
        voxel: [M] int32 canonical voxel to start from (body), else −1.
        points: [M, 3] metres: root space (body) or the object's frame.
    """

    first: A
    ray: A
    depth: A
    kind: A
    voxel: A
    points: A


def _numpy(array: Array) -> np.ndarray:
    return array if isinstance(array, np.ndarray) else array.detach().numpy()


def _kind_of(example: Array, result: np.ndarray) -> Array:
    return result if isinstance(example, np.ndarray) else torch.from_numpy(result)


def _tensor(array: Array, device: torch.device) -> Tensor:
    return torch.as_tensor(array, device=device)


def _tensors(group: Any, device: torch.device) -> Any:
    """The same group with its arrays as tensors on ``device``."""
    values = {field.name: getattr(group, field.name) for field in fields(group)}
    return type(group)(**{name: v if np.isscalar(v) else _tensor(v, device) for name, v in values.items()})


def mark_starts(
    posed: Array,
    centres: Array,
    origin: Array,
    inverse_cell: float,
    dims: Array,
    reach: float,
    apart: float,
    chances: int = 2,
) -> Array:
    """Which canonical voxels each cell of a posed grid is best inverted from.

    Args:
        posed: [V, 3] root-space centres of the occupied canonical voxels; centres: [V, 3] their canonical ones.
        origin: [3] lower corner of the posed grid, metres; inverse_cell: 1/m; dims: [3] cells along each axis.
        reach: cells within this distance of a voxel are marked, metres.
        apart: a second start must lie this far from the first in canonical space (a hand on a thigh), metres.
        chances: starts a cell, 1 or 2.

    Returns:
        [cells, chances] int32, x fastest; −1 where there is none.
    """
    if isinstance(posed, Tensor) and not fast(posed):
        device = posed.device
        return reference.mark_starts(
            posed, _tensor(centres, device), _tensor(origin, device), float(np.float32(inverse_cell)),
            _tensor(dims, device), reach, apart, chances,
        )  # fmt: skip
    counts = _numpy(dims)
    starts = np.empty((int(counts.prod()), chances), dtype=np.int32)
    rest = (
        _numpy(posed), _numpy(centres), _numpy(origin), np.float32(inverse_cell), counts, np.float32(reach),
        np.float32(apart), starts,
    )  # fmt: skip
    in_pieces(lambda begin, end: posing.mark_starts(begin, end, *rest), int(counts[2]), SLAB)
    return _kind_of(posed, starts)


def splat_spans(
    points: Array,
    camera_from_root: Array,
    intrinsics: Array,
    orthographic: bool,
    radius: float,
    near: Array,
    far: Array,
) -> None:
    """Depth spans of every pixel whose ray may come within ``radius`` of a point.

    Args:
        points: [M, 3] root space; camera_from_root: [3, 4]; intrinsics: [3, 3] pixels; radius: metres.
        near, far: [H, W] metres, updated in place: start with near = inf, far = 0.
    """
    if isinstance(points, Tensor) and not fast(points):
        camera, pixels = (_tensor(a, points.device) for a in (camera_from_root, intrinsics))
        reference.splat_spans(points, camera, pixels, orthographic, radius, *_in_place(near, far))
        return
    rest = (
        _numpy(points), _numpy(camera_from_root), _numpy(intrinsics), orthographic, np.float32(radius), _numpy(near),
        _numpy(far),
    )  # fmt: skip
    in_pieces(lambda top, bottom: posing.splat_spans(top, bottom, *rest), len(rest[-1]), BAND)


def march(
    origins: Array,
    directions: Array,
    near: Array,
    far: Array,
    jitter: Array,
    pose: Array,
    step: float,
    grids: StartGrids[Any],
    slots: Slots[Any],
    occupancy: Occupancy[Any],
) -> Candidates[Any]:
    """Finds the candidates of every ray.

    Args:
        origins, directions: [R, 3] root space, unit length along the camera axis.
        near, far: [R] depths, metres, far finite; jitter: [R] in 0…1, shifts the ray's samples by a part of a step.
        pose: [R] int32; step: Euclidean metres between samples.
    """
    if isinstance(origins, Tensor) and not fast(origins):
        on = origins.device
        return reference.march(
            origins, _tensor(directions, on), _tensor(near, on), _tensor(far, on), _tensor(jitter, on),
            _tensor(pose, on), step, _tensors(grids, on), _tensors(slots, on), _tensors(occupancy, on),
        )  # fmt: skip
    rest = (
        *(_numpy(a) for a in (origins, directions, near, far, jitter, pose)), np.float32(step),
        *(_numpy(a) for a in (grids.starts, grids.first, grids.dims, grids.origins)), np.float32(grids.inverse_cell),
        _numpy(slots.part), _numpy(slots.matrix), *_cpu_occupancy(occupancy),
    )  # fmt: skip
    first = np.zeros(len(origins) + 1, dtype=np.int64)
    cpu.march(False, *rest, first, *_room(0))
    np.cumsum(first, out=first)
    ray, depth, kind, voxel, points = room = _room(int(first[-1]))
    cpu.march(True, *rest, first, *room)
    return Candidates(*(_kind_of(origins, a) for a in (first, ray, depth, kind, voxel, points)))


def _room(total: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Memory for ``total`` candidates: ray, depth, kind, voxel, points."""
    kinds = (np.int32, np.float32, np.int32, np.int32)
    ray, depth, kind, voxel = (np.empty(total, dtype=dtype) for dtype in kinds)
    return ray, depth, kind, voxel, np.empty((total, 3), dtype=np.float32)


def _cpu_occupancy(occupancy: Occupancy[Any]) -> tuple[Any, ...]:
    arrays = (occupancy.densities, occupancy.first, occupancy.dims, occupancy.origins)
    return *(_numpy(a) for a in arrays), np.float32(occupancy.inverse_cell)


def prune(
    first: Array,
    depth: Array,
    points: Array,
    part: Array,
    failed: Array,
    step: float,
    trust: float,
    stop: float,
    apart: float,
    occupancy: Occupancy[Any],
) -> Array:
    """Which candidates are worth a field evaluation.

    Dropped are: points in empty cells, failed roots, roots equal to an earlier one of the same sample, and everything
    behind a wall that cached densities already call opaque.

    Args:
        first: [R + 1] int64; depth: [M]; points: [M, 3] local points; part: [M] int32; failed: [M] bool.
        step: metres; trust: share of the cached densities that counts (below 1 to stay on the safe side).
        stop: transmittance, by cached densities, behind which nothing is evaluated.
        apart: roots of one sample closer than this are the same one, metres.

    Returns:
        [M] bool.
    """
    if isinstance(points, Tensor) and not fast(points):
        on = points.device
        return reference.prune(
            _tensor(first, on), _tensor(depth, on), points, _tensor(part, on), _tensor(failed, on),
            step, trust, stop, apart, _tensors(occupancy, on),
        )  # fmt: skip
    keep = np.empty(len(points), dtype=np.bool_)
    cpu.prune(
        _numpy(first), _numpy(depth), _numpy(points), _numpy(part), _numpy(failed),
        np.float32(step), np.float32(trust), np.float32(stop), np.float32(apart), *_cpu_occupancy(occupancy), keep,
    )  # fmt: skip
    return _kind_of(points, keep)


def carve(points: Array, camera_from_root: Array, intrinsics: Array, mask: Array, inside: Array, seen: Array) -> None:
    """Visual hull voting: counts for every point in how many views it is seen and falls inside the mask.

    Args:
        points: [M, 3] root space; camera_from_root: [3, 4]; intrinsics: [3, 3] pixels; mask: [H, W] bool.
        inside, seen: [M] int32, increased in place.
    """
    if isinstance(points, Tensor) and not fast(points):
        camera, pixels = (_tensor(a, points.device) for a in (camera_from_root, intrinsics))
        reference.carve(points, camera, pixels, _tensor(mask, points.device), *_in_place(inside, seen))
        return
    cpu.carve(*(_numpy(a) for a in (points, camera_from_root, intrinsics, mask, inside, seen)))


def _in_place(*arrays: Array) -> list[Tensor]:
    """Tensors that share memory with what the caller passed to be written."""
    return [array if isinstance(array, Tensor) else torch.from_numpy(array) for array in arrays]

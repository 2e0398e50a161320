"""Marching rays through posed cells, plain torch: one row of a tensor for what the fast kernels visit in a loop.

Results come in the order of the fast kernels, and ties go to the lower index as there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from chona_model.kernels.marching import Candidates, Occupancy, Slots, StartGrids

BODY = -1
"""Kind of a candidate on the person; objects have their slot's index."""

UNREACHED = 1e30
"""Squared distance of cells that no voxel reaches."""


def mark_starts(
    posed: Tensor, centres: Tensor, origin: Tensor, inverse_cell: float, dims: Tensor, reach: float, apart: float,
    chances: int,
) -> Tensor:  # fmt: skip
    """Which canonical voxels each cell of a posed grid is best inverted from.

    Args:
        posed: [V, 3] root-space centres of the occupied canonical voxels; centres: [V, 3] their canonical ones.
        origin: [3] lower corner, metres; inverse_cell: 1/m; dims: [3] integer.
        reach: cells within this distance of a voxel are marked, metres.
        apart: a second start lies at least this far from the first in canonical space, metres.
        chances: starts a cell, 1 or 2.

    Returns:
        [cells, chances] int32, x fastest, −1 where there is none.
    """
    cells = int(dims.prod())
    voxel, cell, distance = _reached(posed, origin, inverse_cell, dims, reach)
    first = _nearest(voxel, cell, distance, cells, len(posed))
    columns = [first]
    if chances > 1:
        gap = (centres[voxel] - centres[first[cell].clamp(min=0)]).square().sum(dim=-1)
        other = gap > apart * apart
        columns.append(_nearest(voxel[other], cell[other], distance[other], cells, len(posed)))
    return torch.stack(columns, dim=-1).int()


def _reached(
    posed: Tensor, origin: Tensor, inverse_cell: float, dims: Tensor, reach: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Pairs of a voxel and a cell whose box it reaches, and the squared distance to the cell's centre."""
    radius = int(torch.ceil(posed.new_tensor(reach) * inverse_cell))
    span = torch.arange(-radius, radius + 1, device=posed.device)
    around = torch.cartesian_prod(span, span, span)
    cells = ((posed - origin) * inverse_cell).long()[:, None] + around
    offset = posed[:, None] - (origin + (cells.to(posed.dtype) + 0.5) / inverse_cell)
    box = (offset.abs() - 0.5 / inverse_cell).clamp(min=0.0).square().sum(dim=-1)
    inside = ((cells >= 0) & (cells < dims)).all(dim=-1) & (box <= reach * reach)
    voxel, place = inside.nonzero(as_tuple=True)
    x, y, z = cells[voxel, place].unbind(dim=-1)
    return voxel, x + dims[0] * (y + dims[1] * z), offset[voxel, place].square().sum(dim=-1)


def _nearest(voxel: Tensor, cell: Tensor, distance: Tensor, cells: int, voxels: int) -> Tensor:
    """Voxel of the least distance for every one of ``cells``, the lowest of equals; −1 where there is none."""
    least = distance.new_full((cells,), UNREACHED).scatter_reduce(0, cell, distance, "amin")
    candidate = torch.where(distance == least[cell], voxel, voxels)
    nearest = torch.full((cells,), voxels, device=cell.device).scatter_reduce(0, cell, candidate, "amin")
    return torch.where(nearest < voxels, nearest, -1)


def splat_spans(
    points: Tensor, camera_from_root: Tensor, intrinsics: Tensor, orthographic: bool, radius: float, near: Tensor,
    far: Tensor,
) -> None:  # fmt: skip
    """Depth spans of every pixel whose ray may come within ``radius`` of a point.

    Args:
        points: [M, 3] root space; camera_from_root: [3, 4] and intrinsics: [3, 3] (pixels), of one dtype.
        radius: metres.
        near, far: [H, W] updated: start with near = inf, far = 0.
    """
    height, width = near.shape
    x, y, z = (points.to(camera_from_root.dtype) @ camera_from_root[:, :3].T + camera_from_root[:, 3]).unbind(dim=-1)
    fx, fy, cx, cy = intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]
    if orthographic:
        left, right = fx * (x - radius) + cx, fx * (x + radius) + cx
        top, bottom = fy * (y - radius) + cy, fy * (y + radius) + cy
    else:
        outside = z > 1.5 * radius
        square = torch.where(outside, z * z - radius * radius, 1.0)

        def tangents(side: Tensor, size: int, focal: Tensor, centre: Tensor) -> tuple[Tensor, Tensor]:
            reach = radius * (side * side + square).clamp(min=0.0).sqrt()
            low, high = focal * (side * z - reach) / square + centre, focal * (side * z + reach) / square + centre
            # A camera in or near the sphere sees it in every pixel.
            return torch.where(outside, low, 0.0), torch.where(outside, high, float(size))

        left, right = tangents(x, width, fx, cx)
        top, bottom = tangents(y, height, fy, cy)
    left, top = (torch.floor(low - 0.5).clamp(0, 2**30).long() for low in (left, top))
    right = torch.ceil(right - 0.5).clamp(-1, width - 1).long()
    bottom = torch.ceil(bottom - 0.5).clamp(-1, height - 1).long()
    wide, tall = (right - left + 1).clamp(min=0), (bottom - top + 1).clamp(min=0)
    area = torch.where(z + radius > 0.0, wide * tall, 0)
    point, place = _spread(area)
    pixel = (top[point] + place // wide[point]) * width + left[point] + place % wide[point]
    begin, end = (z - radius).clamp(min=0.0).to(near.dtype), (z + radius).to(far.dtype)
    near.view(-1).scatter_reduce_(0, pixel, begin[point], "amin")
    far.view(-1).scatter_reduce_(0, pixel, end[point], "amax")


def _spread(counts: Tensor) -> tuple[Tensor, Tensor]:
    """For ``counts[i]`` items of each owner i: the owner of every item and its place among the owner's."""
    owner = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    begin = counts.cumsum(dim=0) - counts
    return owner, torch.arange(len(owner), device=counts.device) - begin[owner]


def _cells(points: Tensor, grid: Tensor, dims: Tensor, origins: Tensor, first: Tensor, inverse_cell: float) -> Tensor:
    """Index [M] of the cell that each point [M, 3] lies in, of the concatenated grids; −1 outside its own grid."""
    place = (points - origins[grid]) * inverse_cell
    cell = place.long()
    inside = ((place >= 0.0) & (cell < dims[grid])).all(dim=-1)
    x, y, z = cell.unbind(dim=-1)
    return torch.where(inside, first[grid] + x + dims[grid, 0] * (y + dims[grid, 1] * z), -1)


def _cell_density(points: Tensor, part: Tensor, occupancy: Occupancy[Tensor]) -> Tensor:
    """Cached density [M] of the occupancy cell at local points [M, 3] of parts [M] (0 where a part is −1)."""
    grid = part.long().clamp(min=0)
    cell = _cells(points, grid, occupancy.dims, occupancy.origins, occupancy.first, occupancy.inverse_cell)
    return torch.where((cell >= 0) & (part >= 0), occupancy.densities[cell.clamp(min=0)], 0.0)


def march(
    origins: Tensor, directions: Tensor, near: Tensor, far: Tensor, jitter: Tensor, pose: Tensor, step: float,
    grids: StartGrids[Tensor], slots: Slots[Tensor], occupancy: Occupancy[Tensor],
) -> Candidates[Tensor]:  # fmt: skip
    """Finds the candidates of every ray, in order of rays and depths, the body's before the objects'.

    Args:
        origins, directions: [R, 3] root space, unit length along the camera axis.
        near, far: [R] depths, metres; jitter: [R] in 0…1, shifts the ray's samples by a part of a step.
        pose: [R] integer; step: metres.
        grids, slots, occupancy: posed start grids, objects and occupancy of all parts, as tensors.
    """
    from chona_model.kernels.marching import Candidates

    rays, device = len(origins), origins.device
    # Last bits decide about samples on borders: sums are spelled out, because reductions add in another order, and
    # the root is taken in float64, because vectorised float32 ones are not always the nearest.
    x, y, z = directions.unbind(dim=-1)
    dt = directions.new_tensor(step) / (x * x + y * y + z * z).double().sqrt().to(directions.dtype)
    begin = near + jitter * dt
    # One more than the quotient says, because it is rounded; the comparison below decides as the fast kernel does.
    counts = torch.where(begin < far, torch.ceil((far - begin) / dt) + 1.0, 0.0).long()
    ray, place = _spread(counts)
    depth = begin[ray] + place.to(begin.dtype) * dt[ray]
    before = depth < far[ray]
    ray, depth = ray[before], depth[before]
    points = origins[ray] + depth[:, None] * directions[ray]
    at = pose[ray].long()

    cell = _cells(points, at, grids.dims, grids.origins, grids.first, grids.inverse_cell)
    starts = torch.where(cell[:, None] >= 0, grids.starts[cell.clamp(min=0)], -1)
    part = slots.part[at]
    matrix = slots.matrix[at]
    local = (
        matrix[..., 0] * points[:, None, :1] + matrix[..., 1] * points[:, None, 1:2]
        + matrix[..., 2] * points[:, None, 2:] + matrix[..., 3]
    )  # fmt: skip
    objects = _cell_density(local.reshape(-1, 3), part.flatten(), occupancy).reshape(part.shape) > 0.0
    body = (starts >= 0).long().cumprod(dim=1).bool()

    sample, column = torch.cat([body, objects], dim=1).nonzero(as_tuple=True)
    chances = starts.shape[1]
    is_body = column < chances
    slot = (column - chances).clamp(min=0)
    ray = ray[sample]
    first = torch.zeros(rays + 1, dtype=torch.int64, device=device)
    first[1:] = torch.bincount(ray, minlength=rays).cumsum(dim=0)
    padded_local = local if local.shape[1] else points[:, None]
    return Candidates(
        first=first,
        ray=ray.int(),
        depth=depth[sample],
        kind=torch.where(is_body, BODY, slot).int(),
        voxel=torch.where(is_body, starts[sample, column.clamp(max=chances - 1)], -1).int(),
        points=torch.where(is_body[:, None], points[sample], padded_local[sample, slot]),
    )


def prune(
    first: Tensor, depth: Tensor, points: Tensor, part: Tensor, failed: Tensor, step: float, trust: float, stop: float,
    apart: float, occupancy: Occupancy[Tensor],
) -> Tensor:  # fmt: skip
    """Which candidates are worth a field evaluation.

    Dropped are: points in empty cells, failed roots, roots equal to an earlier one of the same sample, and everything
    behind a wall that cached densities already call opaque.

    Args:
        first: [R + 1]; depth: [M]; points: [M, 3] local points; part: [M] integer; failed: [M] bool.
        step: metres; trust: share of the cached densities that counts; apart: metres.
        stop: transmittance, by cached densities, behind which nothing is evaluated.

    Returns:
        [M] bool.
    """
    ray, _ = _spread(first[1:] - first[:-1])
    new = torch.ones_like(failed)
    new[1:] = (ray[1:] != ray[:-1]) | (depth[1:] != depth[:-1])
    sample = new.long().cumsum(dim=0) - 1
    begin = new.nonzero().squeeze(1)
    density = torch.where(failed, 0.0, _cell_density(points, part, occupancy))
    density = _without_twins(density, points, part, begin, sample, apart)

    densest = density.new_zeros(len(begin)).scatter_reduce(0, sample, density, "amax")
    ray_of_sample = ray[begin]
    samples = torch.bincount(ray_of_sample, minlength=len(first) - 1)
    owner, place = _spread(samples)
    width = int(samples.max()) if len(samples) else 0
    # One column more on the left: what lies before a sample is the sum up to the one in front of it.
    optical = densest.new_zeros(len(samples), width + 1)
    optical[owner, place + 1] = trust * densest * step
    before = optical.cumsum(dim=1)[owner, place]
    limit = -torch.log(density.new_tensor(max(stop, 1e-30)))
    return (density > 0.0) & (before < limit)[sample]


def _without_twins(
    density: Tensor, points: Tensor, part: Tensor, begin: Tensor, sample: Tensor, apart: float
) -> Tensor:
    """``density`` [M] with 0 for candidates closer than ``apart`` to an earlier, kept one of their sample and part."""
    counts = torch.bincount(sample, minlength=len(begin))
    density = density.clone()
    for later in range(1, int(counts.max()) if len(counts) else 0):
        here = begin[counts > later] + later
        for earlier in range(later):
            other = here - later + earlier
            close = (points[other] - points[here]).square().sum(dim=-1) < apart * apart
            twin = close & (density[other] > 0.0) & (part[other] == part[here])
            density[here] = torch.where(twin, 0.0, density[here])
    return density


def carve(
    points: Tensor, camera_from_root: Tensor, intrinsics: Tensor, mask: Tensor, inside: Tensor, seen: Tensor
) -> None:
    """Visual hull voting: counts for every point in how many views it is seen and falls inside the mask.

    Args:
        points: [M, 3] root space; camera_from_root: [3, 4] and intrinsics: [3, 3], of one dtype; mask: [H, W] bool.
        inside, seen: [M] integer, increased.
    """
    height, width = mask.shape
    x, y, z = (points.to(camera_from_root.dtype) @ camera_from_root[:, :3].T + camera_from_root[:, 3]).unbind(dim=-1)
    front = z > 1e-6
    safe = torch.where(front, z, 1.0)
    u = torch.floor(intrinsics[0, 0] * x / safe + intrinsics[0, 2])
    v = torch.floor(intrinsics[1, 1] * y / safe + intrinsics[1, 2])
    hit = front & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    column, row = torch.where(hit, u, 0.0).long(), torch.where(hit, v, 0.0).long()
    seen += hit
    inside += hit & mask[row, column]

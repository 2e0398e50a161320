"""Rays and what rendering them gives, as batches: chosen, checked, empty, joined."""

from __future__ import annotations

import torch
from torch import Tensor

from chona_model.figure import RayBatch, RayResult
from chona_model.geometry import safe_divide
from chona_model.render.integration import EMPTY_DEPTH


def take_rays(rays: RayBatch, rows: Tensor) -> RayBatch:
    """The rays with these indices."""
    return RayBatch(**{name: getattr(rays, name)[rows] for name in RayBatch.__dataclass_fields__})


def finite(rays: RayBatch) -> Tensor:
    """[R] bool: every number of the ray is finite."""
    scalars = torch.isfinite(rays.near) & torch.isfinite(rays.far) & torch.isfinite(rays.radii)
    return scalars & torch.isfinite(rays.origins).all(dim=-1) & torch.isfinite(rays.directions).all(dim=-1)


def empty_result(rays: RayBatch, sound: Tensor, samples: int, slots: int, facing: bool = False) -> RayResult:
    """Rays that miss: transparent, at the empty depth, certain; rays that are not sound fail with all their samples.

    Args:
        slots: objects there are mattes of; facing: whether there are normals.

    ``failed_share`` holds (failed, counted) until chunks are joined.
    """
    zero = torch.zeros_like(rays.near)
    failed = (~sound).sum() * samples
    return RayResult(
        rgb=torch.zeros_like(rays.origins),
        alpha=zero,
        depth=torch.full_like(zero, EMPTY_DEPTH),
        mattes=zero.new_zeros(len(zero), 1 + slots),
        confidence=sound.to(zero),
        failed_share=torch.stack([failed, failed]),
        regularisers={},
        normal=torch.zeros_like(rays.origins) if facing else None,
    )


def join(parts: list[RayResult]) -> RayResult:
    """Chunks one after the other; their counts of failed samples become the share of them all."""
    counts = torch.stack([part.failed_share for part in parts]).sum(dim=0).to(parts[0].alpha)
    names = ["rgb", "alpha", "depth", "mattes", "confidence", *([] if parts[0].normal is None else ["normal"])]
    joined = {name: torch.cat([getattr(part, name) for part in parts]) for name in names}
    return RayResult(**joined, failed_share=safe_divide(counts[0], counts[1]), regularisers={})

"""Depths along rays."""

from __future__ import annotations

import torch
from torch import Tensor


def stratified_edges(near: Tensor, far: Tensor, samples: int, generator: torch.Generator | None = None) -> Tensor:
    """Edges of the ``samples`` intervals of each ray.

    With a generator every inner edge is drawn uniformly from the stretch half-way to its neighbours (mip-NeRF's
    stratified sampling); the outer edges stay at near and far, so that nothing outside is sampled.  Numbers are drawn
    on the generator's device in float64 and then moved: CPU and CUDA see the same.

    Args:
        near, far: [R] depths, metres; rays with ``far <= near`` get empty intervals at ``near``.

    Returns:
        [R, samples + 1] increasing.

    Raises:
        ValueError: fewer than one sample.
    """
    if samples < 1:
        raise ValueError(f"a ray needs at least one sample, got {samples}")
    place = torch.arange(samples + 1, dtype=torch.float64, device=near.device).expand(len(near), -1)
    if generator is not None and samples > 1:
        drawn = torch.rand(len(near), samples - 1, dtype=torch.float64, device=generator.device, generator=generator)
        inner = place[:, 1:-1] + (drawn.to(near.device) - 0.5)
        place = torch.cat([place[:, :1], inner, place[:, -1:]], dim=-1)
    share = (place / samples).to(near.dtype)
    length = (far - near).clamp(min=0.0)
    return near[:, None] + share * length[:, None]

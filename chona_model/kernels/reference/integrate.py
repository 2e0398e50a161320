"""Volume integration over packed candidates, plain torch."""

from __future__ import annotations

import torch
from torch import Tensor


def integrate(
    density: Tensor, rgb: Tensor, first: Tensor, depth: Tensor, delta: Tensor, is_object: Tensor, stop: float
) -> tuple[Tensor, Tensor]:
    """Composites candidates front to back; of those with equal depth on a ray the densest counts.

    Rays are padded to the longest one, so that sums run within a ray: one running sum over all candidates would lose
    a ray's small optical depths in those of the rays before it.

    Args:
        density: [M] 1/m, ≥ 0; rgb: [M, 3].
        first: [R + 1] integer first candidate of each ray.
        depth, delta: [M] metres; is_object: [M] bool.
        stop: transmittance at which a ray ends.

    Returns:
        [R, 6] premultiplied rgb, alpha, Σ w·depth, Σ w over objects; and [M] weights (no gradient), zero for merged
        and skipped candidates.
    """
    rays = len(first) - 1
    chosen, ray = _merge(density.detach(), first, depth)
    # Samples of a ray are consecutive in ``chosen``; ``place`` is where each goes in the padded rows.
    counts = torch.bincount(ray, minlength=rays)
    begin = counts.cumsum(dim=0) - counts
    width = int(counts.max()) if rays else 0
    place = ray * width + torch.arange(len(ray), device=ray.device) - begin[ray]

    def padded(values: Tensor) -> Tensor:
        blank = values.new_zeros(rays * width, *values.shape[1:])
        return blank.index_put((place,), values).unflatten(0, (rays, width))

    optical = padded(density[chosen] * delta[chosen])
    passed = torch.cumsum(optical, dim=1)
    before = torch.cat([torch.zeros_like(passed[:, :1]), passed[:, :-1]], dim=1)[:, :width]
    transmittance = torch.exp(-before)
    weight = torch.where(transmittance < stop, 0.0, transmittance * -torch.expm1(-optical))
    shown = padded(rgb[chosen])
    out = torch.cat(
        [
            (weight[..., None] * shown).sum(dim=1),
            weight.sum(dim=1, keepdim=True),
            (weight * padded(depth[chosen])).sum(dim=1, keepdim=True),
            (weight * padded(is_object[chosen].to(weight.dtype))).sum(dim=1, keepdim=True),
        ],
        dim=1,
    )
    weights = torch.zeros_like(density).index_put((chosen,), weight.detach().flatten()[place])
    return out, weights.detach()


def _merge(density: Tensor, first: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """The densest candidate (the first of equals) of every sample, and its ray: two [samples] tensors."""
    total = len(density)
    places = torch.arange(total, device=density.device)
    ray = torch.repeat_interleave(torch.arange(len(first) - 1, device=density.device), first[1:] - first[:-1])
    new = torch.ones(total, dtype=torch.bool, device=density.device)
    new[1:] = (ray[1:] != ray[:-1]) | (depth[1:] != depth[:-1])
    sample = new.long().cumsum(dim=0) - 1
    samples = int(new.sum())
    densest = density.new_zeros(samples).scatter_reduce(0, sample, density, "amax", include_self=False)
    candidate = torch.where(density == densest[sample], places, total)
    chosen = places.new_zeros(samples).scatter_reduce(0, sample, candidate, "amin", include_self=False)
    return chosen, ray[chosen]

"""The paper's L_w and L_Δ: on points of the canonical bones, weights towards one-hot and offsets towards zero."""

from __future__ import annotations

import torch
from torch import Tensor

from chona_model.deform.skinning import ForwardSkinning
from chona_model.figure import PoseBatch

SAMPLES = 5
"""Points on each bone, as TAVA's."""

POSES = 8
"""Poses of a batch that are looked at: a training step may hold hundreds."""


def bone_regularisers(
    deform: ForwardSkinning, poses: PoseBatch, boxes: Tensor, generator: torch.Generator | None = None
) -> dict[str, Tensor]:
    """Mean squared errors on the body's segments and in the objects' boxes.

    Args:
        boxes: [P, N, 2, 3] canonical corners of every slot's object.
        generator: draws points and poses when given; else points are spread evenly and the first poses are taken.

    Returns:
        ``weights``: of the skinning weights to the one-hot of the bone that the point lies on; ``offset``: of F_Δ to
        zero, square metres.  Absent bones do not count.
    """
    count = min(len(poses.heads), POSES)
    chosen = torch.arange(count)
    if generator is not None and count < len(poses.heads):
        chosen = torch.randperm(len(poses.heads), generator=generator, device=generator.device)[:count]
    chosen = chosen.to(poses.heads.device)
    some = PoseBatch(**{name: getattr(poses, name)[chosen] for name in PoseBatch.__dataclass_fields__})
    corners = boxes[chosen]
    lower = torch.cat([some.heads, corners[:, :, 0]], dim=1)[:, :, None, :]
    upper = torch.cat([some.tails, corners[:, :, 1]], dim=1)[:, :, None, :]
    bones = lower.shape[1]
    shares = _shares(count, bones, some.heads.shape[1], generator).to(lower)
    points = (lower + shares * (upper - lower)).reshape(-1, 3)
    index = torch.arange(count, device=points.device).repeat_interleave(bones * SAMPLES)
    bone = torch.arange(bones, device=points.device).repeat_interleave(SAMPLES).repeat(count)
    here = some.present[index, bone]
    points, index, bone = points[here], index[here], bone[here]
    weights = deform.weights(points, some, index)
    wanted = torch.nn.functional.one_hot(bone, weights.shape[-1]).to(weights)
    offsets = deform.offset(points, some.codes, index)
    return {"weights": (weights - wanted).square().mean(), "offset": offsets.square().mean()}


def _shares(count: int, bones: int, body: int, generator: torch.Generator | None) -> Tensor:
    """[count, bones, SAMPLES, 3] places between the corners; a segment has one for all coordinates, a box three."""
    if generator is None:
        even = (torch.arange(SAMPLES, dtype=torch.float64) + 0.5) / SAMPLES
        return even[None, None, :, None].expand(count, bones, -1, 3)
    drawn = torch.rand(
        count, bones, SAMPLES, 3, generator=generator, dtype=torch.float64, device=generator.device
    ).cpu()
    drawn[:, :body] = drawn[:, :body, :, :1].clone()
    return drawn

"""Short supervised pre-training of the skinning weights, so that training starts from a body that already bends.

From a body model's surface where the capture has one, else from the distances to the bones; objects' boxes become
one-hot on their bones, and what is far from everything becomes background.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from chona_model.data.dataset import SkinnedSurface
from chona_model.deform.skinning import SkinningMLP
from chona_model.field.codes import step_generator
from chona_model.geometry import box_distances, segment_distances

BODY_MARGIN = 0.08
"""Metres around the surface (or beyond a bone's reach) that still move with the body: clothes and hair."""

FADE = 0.04
"""Metres over which the body's weights then fade into the background's."""

BONE_FALLOFF = 0.03
"""Without a surface, weights fall by e for every 3 cm of distance to a bone beyond the nearest one's."""

BONE_REACH = 0.15
"""Metres from a bone at which a body without a surface is taken to end."""

Boxes = list[tuple[np.ndarray, np.ndarray]]
"""Lower and upper corners [3] of each object slot's box in canonical space."""


def initialise_from_surface(
    skinning: SkinningMLP,
    surface: SkinnedSurface,
    boxes: Boxes,
    *,
    lower: np.ndarray,
    upper: np.ndarray,
    steps: int = 400,
    batch: int = 2048,
    seed: int = 0,
) -> float:
    """Fits the weights to those of the nearest vertex of a body model.

    Args:
        surface: of the canonical body; weights [V, B].
        boxes: one a slot, in canonical space.
        lower, upper: [3] corners of canonical space, from which the background is sampled.
        steps, batch: of Adam.

    Returns:
        The last mean absolute error of a weight.

    Raises:
        ValueError: the numbers of bones, boxes and outputs do not fit.
    """
    bones = surface.weights.shape[1]
    _check(skinning, bones, boxes)
    tree = cKDTree(surface.vertices)

    def near(generator: np.random.Generator, count: int) -> np.ndarray:
        chosen = surface.vertices[generator.integers(0, len(surface.vertices), count)]
        return chosen + generator.normal(scale=0.5 * BODY_MARGIN, size=(count, 3))

    def weights(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance, nearest = tree.query(points)
        return surface.weights[nearest], distance - BODY_MARGIN

    return _fit(skinning, near, weights, boxes, extent=(lower, upper), steps=steps, batch=batch, seed=seed)


def initialise_from_bones(
    skinning: SkinningMLP,
    heads: np.ndarray,
    tails: np.ndarray,
    boxes: Boxes,
    *,
    lower: np.ndarray,
    upper: np.ndarray,
    steps: int = 400,
    batch: int = 2048,
    seed: int = 0,
) -> float:
    """Fits the weights to a softmax of negative distances to the bone segments [B, 3]; arguments as above."""
    _check(skinning, len(heads), boxes)
    head, tail = torch.as_tensor(heads, dtype=torch.float64), torch.as_tensor(tails, dtype=torch.float64)

    def near(generator: np.random.Generator, count: int) -> np.ndarray:
        chosen = generator.integers(0, len(heads), count)
        share = generator.random((count, 1))
        on_bone = heads[chosen] + share * (tails[chosen] - heads[chosen])
        return on_bone + generator.normal(scale=0.5 * BONE_REACH, size=(count, 3))

    def weights(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance = segment_distances(torch.as_tensor(points)[:, None, :], head, tail)
        soft = torch.softmax(-distance / BONE_FALLOFF, dim=-1)
        return soft.numpy(), distance.amin(dim=-1).numpy() - BONE_REACH

    return _fit(skinning, near, weights, boxes, extent=(lower, upper), steps=steps, batch=batch, seed=seed)


def _check(skinning: SkinningMLP, bones: int, boxes: Boxes) -> None:
    assert skinning.mlp.output is not None
    outputs = skinning.mlp.output.out_features
    if bones + len(boxes) + 1 != outputs:
        raise ValueError(
            f"the skinning weights have {outputs} outputs, but {bones} bones, {len(boxes)} object boxes and the "
            f"background were given ({bones + len(boxes) + 1})"
        )


def _targets(
    points: np.ndarray, body: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], boxes: Boxes
) -> np.ndarray:
    """Weights [M, J + 1] wanted at canonical points: whichever of body and objects is nearer, fading to background."""
    weights, distance = body(points)
    bones = weights.shape[1]
    target = np.zeros((len(points), bones + len(boxes) + 1))
    target[:, :bones] = weights / weights.sum(axis=1, keepdims=True)
    at = torch.as_tensor(points)
    for slot, (low, high) in enumerate(boxes):
        reach = box_distances(at, torch.as_tensor(low), torch.as_tensor(high)).numpy() - 0.5 * BODY_MARGIN
        nearer = reach < distance
        target[nearer] = 0.0
        target[nearer, bones + slot] = 1.0
        distance = np.minimum(distance, reach)
    away = np.clip(distance / FADE, 0.0, 1.0)[:, None]
    target *= 1.0 - away
    target[:, -1:] += away
    return target


def _fit(
    skinning: SkinningMLP,
    near: Callable[[np.random.Generator, int], np.ndarray],
    body: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    boxes: Boxes,
    *,
    extent: tuple[np.ndarray, np.ndarray],
    steps: int,
    batch: int,
    seed: int,
) -> float:
    parameter = next(skinning.parameters())
    generator = np.random.default_rng(int(torch.randint(2**31, (1,), generator=step_generator(seed, 0))))
    optimiser = torch.optim.Adam(skinning.parameters(), lr=5e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1), eta_min=1e-4)
    error = float("nan")
    for _ in range(steps):
        parts = [near(generator, batch // 2), generator.uniform(*extent, size=(batch // 4, 3))]
        parts += [
            generator.uniform(low - BODY_MARGIN, high + BODY_MARGIN, size=(max(batch // (4 * len(boxes)), 1), 3))
            for low, high in boxes
        ]
        points = np.concatenate(parts)
        target = torch.as_tensor(_targets(points, body, boxes)).to(parameter)
        logits = skinning.logits(torch.as_tensor(points).to(parameter))
        loss = -(target * torch.log_softmax(logits, dim=-1)).sum(dim=-1).mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        schedule.step()
        error = _mean_error(logits, target)
    optimiser.zero_grad(set_to_none=True)
    return error


def _mean_error(logits: Tensor, target: Tensor) -> float:
    return float((torch.softmax(logits.detach(), dim=-1) - target).abs().mean())

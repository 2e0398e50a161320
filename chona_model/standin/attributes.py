"""What a stand-in's vertices carry besides their places: colours and skinning weights."""

from __future__ import annotations

import numpy as np

from chona_model.standin.part import CHUNK, Part
from chona_model.standin.surface import Step

BONES = 4
"""Bones a vertex follows at most, as game engines have it."""

FAINT = 0.01
"""A bone that weighs less is left out."""

OUTSIDE, INSIDE, STEP = 1.5, 4.0, 0.5
"""Where a colour is looked for, in voxels: from outside the surface along the inward normal, and between samples."""


def colours(part: Part, vertices: np.ndarray, normals: np.ndarray, voxel: float, step: Step) -> np.ndarray:
    """[V, 3] float32 sRGB: what a ray along −normal integrates on its way through the surface, over its alpha."""
    depths = np.arange(-OUTSIDE, INSIDE + STEP / 2, STEP) * voxel
    found = np.zeros((len(vertices), 3), dtype=np.float32)
    at_once = max(CHUNK // len(depths), 1)
    for begin in range(0, len(vertices), at_once):
        rows = slice(begin, begin + at_once)
        points = (vertices[rows, None] - depths[:, None] * normals[rows, None]).reshape(-1, 3)
        density = np.where(part.holds(points), part.density(points, STEP * voxel), 0.0)
        rgb = part.colour(points, STEP * voxel).reshape(-1, len(depths), 3)
        optical = (density * (STEP * voxel)).reshape(-1, len(depths))
        before = np.cumsum(optical, axis=1) - optical
        weight = np.exp(-before) * -np.expm1(-optical)
        total = weight.sum(axis=1, keepdims=True)
        # A ray that meets nothing (the surface was smoothed away from it) takes the colour on the surface.
        middle = rgb[:, int(np.argmin(np.abs(depths)))]
        mean = (weight[..., None] * rgb).sum(axis=1) / np.maximum(total, np.finfo(np.float32).tiny)
        found[rows] = np.where(total > FAINT, mean, middle)
        step(len(points))
    return np.clip(found, 0.0, 1.0)


def colour_samples() -> int:
    """Points that ``colours`` asks for a vertex."""
    return len(np.arange(-OUTSIDE, INSIDE + STEP / 2, STEP))


def strongest(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The strongest bones of every vertex.

    Args:
        weights: [V, B] rows sum to one.

    Returns:
        bones [V, BONES] int16, strongest first, −1 where there are fewer; weights [V, BONES] float32: 0 there, at least
        ``FAINT`` elsewhere, rows sum to one.
    """
    count = min(BONES, weights.shape[1])
    order = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    chosen = np.take_along_axis(weights, order, axis=1)
    # The strongest always stays: of B bones it weighs 1 / B at least.
    keep = (chosen >= FAINT) | (np.arange(count) == 0)
    chosen = np.where(keep, chosen, 0.0)
    chosen /= chosen.sum(axis=1, keepdims=True)
    spare = ((0, 0), (0, BONES - count))
    bones = np.pad(np.where(keep, order, -1).astype(np.int16), spare, constant_values=-1)
    return bones, np.pad(chosen, spare).astype(np.float32)

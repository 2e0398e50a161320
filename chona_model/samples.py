"""Several actors in one picture: their samples sorted along every ray, not their pictures laid over each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from functools import reduce
from typing import Any

import numpy as np

from chona_model.actor import EMPTY_DEPTH, Picture, Samples, merge
from chona_model.camera import Camera
from chona_model.passes import DEFAULT_PASSES, Passes

CLOSEST_TO_OPAQUE = 1.0 - 1e-12
"""Opacity above which light that is left would be lost to rounding."""


def no_samples(passes: Passes = DEFAULT_PASSES, parts: int = 0) -> Samples:
    """None of anything, with what passes ask for; of a pose of so many parts."""
    nothing, vectors = np.zeros(0, np.float32), np.zeros((0, 3), np.float32)
    return Samples(
        np.zeros(0, np.int64), nothing, nothing, vectors, nothing, vectors if passes.normal else None,
        np.zeros((0, parts), np.float32) if passes.cryptomatte else None,
    )  # fmt: skip


def join(parts: Sequence[Samples]) -> Samples:
    """Samples of several pieces of work, one at least."""
    columns = {field.name: [getattr(part, field.name) for part in parts] for field in fields(Samples)}
    joined: dict[str, Any] = {name: None if each[0] is None else np.concatenate(each) for name, each in columns.items()}
    return Samples(**joined)


def densest(ray: np.ndarray, depth: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Indices of the samples that count: where several roots share a ray and a depth, the densest of them."""
    order = np.lexsort((-density, depth, ray))
    new = (np.diff(ray[order]) != 0) | (np.diff(depth[order]) != 0)
    return order[np.concatenate([np.ones(min(len(order), 1), bool), new])]


def over_each_other(pictures: Sequence[Picture]) -> np.ndarray:
    """[H, W] bool: pixels in which more than one of the pictures shows something."""
    return np.add.reduce([(picture.alpha > 0).astype(np.int8) for picture in pictures]) > 1


def beside_each_other(pictures: Sequence[Picture]) -> Picture:
    """One picture of several, right wherever at most one of them shows anything; the least confidence of all."""
    parts = [picture.parts for picture in pictures if picture.parts is not None]
    alone = [replace(picture, parts=None) for picture in pictures]
    together = reduce(lambda one, other: merge(one, other, (other.alpha > 0) & (one.alpha == 0)), alone)
    return replace(
        together, confidence=np.minimum.reduce([picture.confidence for picture in pictures]),
        parts=np.concatenate(parts, axis=-1) if parts else None,
    )  # fmt: skip


def weights_along(ray: np.ndarray, alpha: np.ndarray, stop: float = 0.0) -> np.ndarray:
    """[N] float64 share of its ray's light that each sample shows: w_i = α_i Π_{j<i} (1 − α_j).

    Args:
        ray: [N], those of one ray together and in order of depth; alpha: [N] opacities.
        stop: transmittance behind which nothing is seen.
    """
    alpha = np.minimum(alpha.astype(np.float64), CLOSEST_TO_OPAQUE)
    light = _transmittance(ray, alpha)
    return np.where(light < stop, 0.0, light * alpha)


def composite(actors: Sequence[Samples], camera: Camera, side: int, picture: Picture, pixels: np.ndarray) -> Picture:
    """``picture`` with the given ``pixels`` [H, W] bool integrated over all actors' samples in order of depth.

    Along a ray w_i = α_i Π_{j<i} (1 − α_j) over the samples of all actors, as volume rendering has it for their
    densities in one field. Depth is that of the actor with the largest share: a mean would lie between them.

    Args:
        side: rays a pixel along each axis.
    """
    everything = join([replace(samples, parts=None) for samples in actors])
    owner = np.repeat(np.arange(len(actors)), [len(actor.ray) for actor in actors])
    order = np.lexsort((everything.depth, everything.ray))
    ray = everything.ray[order]
    weight = weights_along(ray, everything.alpha[order]) / side**2
    place, inverse = np.unique(ray // side**2, return_inverse=True)

    def gather(values: np.ndarray | float) -> np.ndarray:
        return np.bincount(inverse, weight * values, minlength=len(place))

    rgb = np.stack([gather(everything.rgb[order, k]) for k in range(3)], axis=-1)
    total, thing = gather(1.0), gather(everything.thing[order])
    shares = np.stack([gather(owner[order] == number) for number in range(len(actors))])
    depths = np.stack([gather((owner[order] == number) * everything.depth[order]) for number in range(len(actors))])
    first = shares.argmax(axis=0)[None]
    share, depth = (np.take_along_axis(array, first, axis=0)[0] for array in (shares, depths))
    rows, columns = np.divmod(place, camera.width)
    wanted = pixels[rows, columns]
    at = rows[wanted], columns[wanted]
    shown = ("rgb", "alpha", "human", "object")
    result = replace(picture, **{name: getattr(picture, name).copy() for name in (*shown, "depth")})
    for name in shown:
        getattr(result, name)[pixels] = 0.0
    result.depth[pixels] = EMPTY_DEPTH
    result.rgb[at], result.alpha[at] = rgb[wanted], np.clip(total[wanted], 0.0, 1.0)
    result.object[at] = np.clip(thing[wanted], 0.0, result.alpha[at])
    result.human[at] = result.alpha[at] - result.object[at]
    result.depth[at] = np.where(share > 0, depth / np.where(share > 0, share, 1.0), EMPTY_DEPTH)[wanted]
    facing = () if everything.normal is None else everything.normal[order].T
    asked_for: dict[str, Any] = {}
    for name, columns_of in (("normal", facing), ("parts", _part_columns(actors, order))):
        if getattr(picture, name) is not None:
            array = np.where(pixels[..., None], np.float32(0.0), getattr(picture, name))
            for column, values in enumerate(columns_of):
                array[*at, column] = gather(values)[wanted]
            asked_for[name] = array
    return replace(result, **asked_for)


def _part_columns(actors: Sequence[Samples], order: np.ndarray) -> Iterator[np.ndarray]:
    """Of every part of every actor, its share [N] of each of all actors' samples, which are put in order."""
    begin = 0
    for samples in actors:
        end = begin + len(samples.ray)
        for column in () if samples.parts is None else samples.parts.T:
            shares = np.zeros(len(order), dtype=np.float32)
            shares[begin:end] = column
            yield shares[order]
        begin = end


def _transmittance(ray: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """[N] light that reaches each sample; samples are sorted by ray, then depth."""
    if len(ray) == 0:
        return np.zeros(0)
    passed = np.cumsum(np.log1p(-alpha))
    before = passed - np.log1p(-alpha)
    starts = np.flatnonzero(np.concatenate([[True], ray[1:] != ray[:-1]]))
    lengths = np.diff(np.concatenate([starts, [len(ray)]]))
    return np.exp(before - np.repeat(before[starts], lengths))

"""Rays of one pose traced to their ends, for pictures and, with their samples kept for the way back, for training.

One entry for both: what it is made of takes most of a minute to compile.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chona_model.kernels.cpu.advance import COLUMNS, RAYS, ROOM, Candidates, make_block, make_candidates, start_ray
from chona_model.kernels.cpu.jit import entry, inner
from chona_model.kernels.cpu.perceptron import make_activations
from chona_model.kernels.cpu.trace import trace_block


class GivenRays(NamedTuple):
    """Rays of one pose.

    Attributes:
        origins, directions: [R, 3] root space; near, far: [R] depths; jitter: [R] 0…1; all float32.
        pair: [R, 1 + N] int64 row of the biases for the person and for each slot's object; pose: row of the biases of
            the shading.
    """

    origins: np.ndarray
    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray
    jitter: np.ndarray
    pair: np.ndarray
    pose: int


@entry
def aim(first, pixels, near, far, lens, drift, side, origins, directions, ray_near, ray_far):
    """Rays through pixels from ``first`` on, ``side`` along each axis of each, those of a pixel together.

    Args:
        pixels: [R, 2] int32 column and row; near, far: [R] float32 depths.
        lens: [4, 3]: the ray through (u, v) is ``lens[0] + t (lens[1] + u lens[2] + v lens[3])``, root space.
        drift: [2, 3]: how its origin moves with u and v (orthographic cameras).
        origins, directions: [P · side², 3], ray_near, ray_far: [P · side²], written for P pixels.
    """
    half, scale = np.float32(0.5), np.float32(side)
    for r in range(len(ray_near)):
        pixel, sub = first + r // (side * side), r % (side * side)
        u = np.float32(pixels[pixel, 0]) + (np.float32(sub % side) + half) / scale
        v = np.float32(pixels[pixel, 1]) + (np.float32(sub // side) + half) / scale
        for k in range(3):
            origins[r, k] = lens[0, k] + u * drift[0, k] + v * drift[1, k]
            directions[r, k] = lens[1, k] + u * lens[2, k] + v * lens[3, k]
        ray_near[r], ray_far[r] = near[pixel], far[pixel]


@inner
def _aim_given(rays, first, count, step, parts, block):
    for r in range(count):
        for k in range(3):
            block.origin[r, k], block.direction[r, k] = rays.origins[first + r, k], rays.directions[first + r, k]
        for slot in range(block.pair.shape[1]):
            block.pair[r, slot] = rays.pair[first + r, slot]
        start_ray(r, rays.near[first + r], rays.far[first + r], rays.jitter[first + r], step, parts, block)


@entry
def sample(begin, end, keep, rays, volume, starts, parts, tables, net, limits, out):
    """Traces the rays ``begin`` to ``end``.

    Args:
        keep: whether what was evaluated is kept.
        out: [R, COLUMNS] written.

    Returns:
        How often the field was evaluated. Of what is kept: candidates in the order of evaluation, their ``ray`` counted
        from ``begin``; first [end − begin + 1] and order [M]: candidates of ray r in order of depth are
        ``order[first[r]:first[r + 1]]``.
    """
    inputs = net.both.shape[0]
    block, act = make_block(len(parts.slot_part), starts.points.shape[1]), make_activations(net)
    found, n, evaluated = make_candidates(16 * RAYS + ROOM if keep else ROOM, inputs, rays.pose), 0, 0
    for block_begin in range(begin, end, RAYS):
        count, after = min(RAYS, end - block_begin), -1
        while after < 0:
            _aim_given(rays, block_begin, count, limits.step, parts, block)
            after, more = trace_block(count, keep, n, volume, starts, parts, tables, net, limits, block, found, act)
            if after < 0:
                found = _with_more_room(found, n)
        evaluated += more
        if keep:
            for m in range(n, after):
                found.ray[m] += block_begin - begin
            n = after
        for r in range(count):
            for k in range(COLUMNS):
                out[block_begin + r, k] = block.result[r, k]
    first, order = np.zeros(end - begin + 1, np.int64), np.empty(n, np.int64)
    for m in range(n):
        first[found.ray[m] + 1] += 1
    for r in range(end - begin):
        first[r + 1] += first[r]
    place = first[:-1].copy()
    for m in range(n):  # candidates of a ray were found front to back
        r = found.ray[m]
        order[place[r]] = m
        place[r] += 1
    kept = Candidates(
        found.ray[:n], found.part[:n], found.pair[:n], found.pose[:n], found.thing[:n], found.depth[:n],
        found.point[:n], found.normal[:n], found.gain[:n], found.x[:n], found.density[:n], found.rgb[:n],
    )  # fmt: skip
    return evaluated, kept, first, order


@entry
def _with_more_room(found, used):
    """The same candidates in twice the memory."""
    larger = make_candidates(2 * len(found.ray), found.x.shape[1], found.pose[0])
    for m in range(used):
        larger.ray[m], larger.part[m], larger.pair[m] = found.ray[m], found.part[m], found.pair[m]
        larger.thing[m], larger.depth[m], larger.density[m] = found.thing[m], found.depth[m], found.density[m]
        for k in range(3):
            larger.point[m, k], larger.rgb[m, k] = found.point[m, k], found.rgb[m, k]
            larger.normal[m, k], larger.gain[m, k] = found.normal[m, k], found.gain[m, k]
        for k in range(found.x.shape[1]):
            larger.x[m, k] = found.x[m, k]
    return larger


@entry
def sample_backward(first, order, found, step, stop, grad_out, grad_density, grad_rgb):
    """Gradients of a piece's integrals.

    Args:
        first, order, found: what ``sample`` returned; step, stop: its limits.
        grad_out: [R, 6] of premultiplied rgb, alpha, Σ w·depth and Σ w over objects.
        grad_density: [M], grad_rgb: [M, 3], written.
    """
    zero = np.float32(0.0)
    for m in range(len(order)):
        grad_density[m] = zero
        grad_rgb[m, 0] = grad_rgb[m, 1] = grad_rgb[m, 2] = zero
    for r in range(len(first) - 1):
        behind = _walk(r, first, order, found, step, stop, grad_out, zero, False, grad_density, grad_rgb)
        _walk(r, first, order, found, step, stop, grad_out, behind, True, grad_density, grad_rgb)


@inner
def _walk(r, first, order, found, step, stop, grad_out, behind, write, grad_density, grad_rgb):
    """Front to back along a ray: the sum of what its samples contribute to the loss; then (``write``) their gradients,
    given that sum."""
    light, total, i = np.float32(1.0), np.float32(0.0), first[r]
    while i < first[r + 1]:
        chosen = order[i]
        i += 1
        while i < first[r + 1] and found.depth[order[i]] == found.depth[chosen]:
            if found.density[order[i]] > found.density[chosen]:
                chosen = order[i]
            i += 1
        if light < stop:
            break
        after = light * np.exp(-found.density[chosen] * step)
        weight = light - after
        value = grad_out[r, 3] + grad_out[r, 4] * found.depth[chosen]
        for k in range(3):
            value += grad_out[r, k] * found.rgb[chosen, k]
        if found.thing[chosen]:
            value += grad_out[r, 5]
        total += weight * value
        if write:
            grad_density[chosen] = step * (after * value - (behind - total))
            for k in range(3):
                grad_rgb[chosen, k] = weight * grad_out[r, k]
        light = after
    return total

"""Volume integration over packed candidates, forward and backward.

Candidates of one ray are consecutive and in order of depth; those with equal depth are several roots of one sample, of
which the densest counts (as TAVA and SNARF merge them) and carries the gradient.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from chona_model.kernels.cpu.jit import RELAXED


@njit(parallel=True, fastmath=RELAXED, cache=True)
def integrate(first, depth, delta, density, rgb, is_object, stop, out, weights):
    """Front to back.

    Args:
        first: [R + 1] int64 first candidate of every ray.
        depth, delta, density: [M] depth along the camera axis, Euclidean length of the step (m), 1/m.
        rgb: [M, 3]; is_object: [M] bool.
        stop: transmittance at which a ray ends.
        out: [R, 6] written: premultiplied rgb, alpha, Σ w·depth, Σ w over objects.
        weights: [M] written, zero for merged and skipped candidates.
    """
    for r in prange(len(first) - 1):
        transmittance = np.float32(1.0)
        o0 = o1 = o2 = o3 = o4 = o5 = np.float32(0.0)
        m, end = first[r], first[r + 1]
        while m < end:
            chosen = m
            weights[m] = np.float32(0.0)
            m += 1
            while m < end and depth[m] == depth[chosen]:
                weights[m] = np.float32(0.0)
                if density[m] > density[chosen]:
                    chosen = m
                m += 1
            if transmittance < stop:
                continue
            alpha = -np.expm1(-density[chosen] * delta[chosen])
            weight = transmittance * alpha
            weights[chosen] = weight
            o0 += weight * rgb[chosen, 0]
            o1 += weight * rgb[chosen, 1]
            o2 += weight * rgb[chosen, 2]
            o3 += weight
            o4 += weight * depth[chosen]
            if is_object[chosen]:
                o5 += weight
            transmittance *= np.float32(1.0) - alpha
        out[r, 0], out[r, 1], out[r, 2], out[r, 3], out[r, 4], out[r, 5] = o0, o1, o2, o3, o4, o5


@njit(parallel=True, fastmath=RELAXED, cache=True)
def integrate_backward(first, depth, delta, density, rgb, is_object, weights, stop, grad_out, grad_density, grad_rgb):
    """Gradients of ``integrate``'s rgb, alpha and object columns ([R, 6]; the depth column's is used too).

    Writes grad_density [M] and grad_rgb [M, 3]; candidates that carried no weight get zero, except where only their
    density was zero and light reached them.
    """
    for r in prange(len(first) - 1):
        g0, g1, g2, g3, g4, g5 = (
            grad_out[r, 0], grad_out[r, 1], grad_out[r, 2], grad_out[r, 3], grad_out[r, 4], grad_out[r, 5],
        )  # fmt: skip
        total = np.float32(0.0)
        for m in range(first[r], first[r + 1]):
            if weights[m] != 0.0:
                value = g0 * rgb[m, 0] + g1 * rgb[m, 1] + g2 * rgb[m, 2] + g3 + g4 * depth[m]
                if is_object[m]:
                    value += g5
                total += weights[m] * value
        transmittance = np.float32(1.0)
        behind = total
        m, end = first[r], first[r + 1]
        while m < end:
            chosen = m
            begin = m
            m += 1
            while m < end and depth[m] == depth[chosen]:
                if density[m] > density[chosen]:
                    chosen = m
                m += 1
            for other in range(begin, m):
                grad_density[other] = np.float32(0.0)
                grad_rgb[other, 0] = grad_rgb[other, 1] = grad_rgb[other, 2] = np.float32(0.0)
            weight = weights[chosen]
            optical = density[chosen] * delta[chosen]
            if transmittance < stop or (weight == 0.0 and optical > 0.0):
                continue  # behind the stop
            value = g0 * rgb[chosen, 0] + g1 * rgb[chosen, 1] + g2 * rgb[chosen, 2] + g3 + g4 * depth[chosen]
            if is_object[chosen]:
                value += g5
            behind -= weight * value
            after = transmittance * np.exp(-optical)
            grad_density[chosen] = delta[chosen] * (after * value - behind)
            grad_rgb[chosen, 0] = weight * g0
            grad_rgb[chosen, 1] = weight * g1
            grad_rgb[chosen, 2] = weight * g2
            transmittance = after

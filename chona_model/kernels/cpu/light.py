"""Light on surfaces: which way they face in canonical space, and how much a pose's light favours that."""

from __future__ import annotations

import numpy as np

from chona_model.kernels.cpu.jit import inlined

TERMS = 9
"""Of a quadratic in a normal: x, y, z, x², y², z², xy, yz, zx."""

FAINT = np.float32(1e-12)
"""Squared length under which a normal says nothing."""


@inlined
def normal_at(x, y, z, part, parts):
    """Normal, of any length, at a point in a part's own frame: interpolated between the centres of its cells."""
    one, half, zero, edge = np.float32(1.0), np.float32(0.5), np.float32(0.0), np.float32(1e-3)
    nx, ny, nz = parts.dims[part, 0], parts.dims[part, 1], parts.dims[part, 2]
    px = (x - parts.origins[part, 0]) * parts.inverse_cell - half
    py = (y - parts.origins[part, 1]) * parts.inverse_cell - half
    pz = (z - parts.origins[part, 2]) * parts.inverse_cell - half
    px = min(max(px, zero), np.float32(nx - 1) - edge)
    py = min(max(py, zero), np.float32(ny - 1) - edge)
    pz = min(max(pz, zero), np.float32(nz - 1) - edge)
    ix, iy, iz = np.int64(px), np.int64(py), np.int64(pz)
    u, v, w = px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz)
    first = parts.first[part] + ix + nx * (iy + ny * iz)
    n0, n1, n2 = zero, zero, zero
    for corner in range(8):
        dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
        share = (u if dx else one - u) * (v if dy else one - v) * (w if dz else one - w)
        cell = first + dx + nx * (dy + ny * dz)
        n0 += share * parts.normals[cell, 0]
        n1 += share * parts.normals[cell, 1]
        n2 += share * parts.normals[cell, 2]
    return n0, n1, n2


@inlined
def unit(x, y, z):
    """The vector at length one; zero where it is too short to have a direction."""
    square = x * x + y * y + z * z
    scale = np.float32(1.0) / np.sqrt(square) if square > FAINT else np.float32(0.0)
    return x * scale, y * scale, z * scale


@inlined
def log_gain(x, y, z, light, k):
    """Logarithm of what light [TERMS, 3] makes of colour ``k`` of a surface that faces (x, y, z)."""
    return (
        light[0, k] * x + light[1, k] * y + light[2, k] * z
        + light[3, k] * x * x + light[4, k] * y * y + light[5, k] * z * z
        + light[6, k] * x * y + light[7, k] * y * z + light[8, k] * z * x
    )  # fmt: skip

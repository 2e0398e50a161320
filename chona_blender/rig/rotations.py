"""Rotations on arrays, with numpy alone."""

from __future__ import annotations

import numpy as np

_TINY = 1e-12


def unit(vectors: np.ndarray) -> np.ndarray:
    """[..., 3] vectors of length 1; zero where there is no direction."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > _TINY)


def swing(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotations [..., 3, 3] that take directions ``start`` [..., 3] to ``end`` [..., 3].

    Identity where either is zero; half a turn about any axis across where they are opposite.
    """
    a, b = np.broadcast_arrays(unit(np.asarray(start, float)), unit(np.asarray(end, float)))
    axis = (cross_matrix(a) @ b[..., None])[..., 0]
    cosine = (a * b).sum(-1)[..., None, None]
    skew = cross_matrix(axis)
    eye = np.broadcast_to(np.eye(3), skew.shape)
    opposite = cosine < -1.0 + 1e-9
    turned = eye + skew + skew @ skew / np.where(opposite, 1.0, 1.0 + cosine)
    known = ((a * a).sum(-1) > 0.5) & ((b * b).sum(-1) > 0.5)
    if opposite.any():
        across = unit(np.cross(a, np.where(np.abs(a[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])))
        turned = np.where(opposite, 2.0 * across[..., :, None] * across[..., None, :] - eye, turned)
    return np.where(known[..., None, None], turned, eye)


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """[..., 3, 3] matrices that multiply as ``cross(vectors, ·)``."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vectors.shape, 3)


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """[3, 3] rotation by ``angle`` radians about ``axis`` [3]."""
    skew = cross_matrix(unit(np.asarray(axis, float)))
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew


def nearest(matrices: np.ndarray) -> np.ndarray:
    """Rotations [..., 3, 3] nearest to matrices whose determinant is positive."""
    left, _, right = np.linalg.svd(matrices)
    sign = np.sign(np.linalg.det(left @ right))
    left = left.copy()
    left[..., :, 2] *= sign[..., None]
    return left @ right


def angle_of(rotations: np.ndarray) -> np.ndarray:
    """Angles [...] of rotations [..., 3, 3] in radians, exact for small ones."""
    trace = np.trace(rotations, axis1=-2, axis2=-1)
    skew = rotations - np.swapaxes(rotations, -1, -2)
    sine = np.sqrt((skew * skew).sum((-2, -1)) / 2.0)
    return np.arctan2(sine, trace - 1.0)


def matrices_of(vectors: np.ndarray) -> np.ndarray:
    """Rotations [..., 3, 3] of rotation vectors [..., 3] (axis times angle, radians)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    skew = cross_matrix(vectors)
    return np.eye(3) + np.sinc(angle / np.pi) * skew + 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2 * (skew @ skew)

"""What arrays of a shot are checked for, and the error that says what is wrong with one."""

from __future__ import annotations

import numpy as np

from chona_model.camera import FARTHEST

RIGID_TOLERANCE = 1e-4
"""Largest entry of RᵀR − I and of the last row's error that still counts as rigid."""

LARGEST_DEPTH = float(np.finfo(np.float32).max)
"""Kernels, frames and Blender hold depths in single precision."""


class ShotError(ValueError):
    """A shot that cannot be rendered: the message says what was found, what was expected and what to do."""


def check_intrinsics(matrices: np.ndarray, frames: np.ndarray) -> None:
    """``ShotError`` where one of ``matrices`` [F, 3, 3] is no pinhole's or parallel projection's."""
    for matrix, frame in zip(matrices, frames, strict=True):
        if not (np.abs(matrix) <= FARTHEST).all():
            raise ShotError(f"the camera's intrinsics in frame {frame} are not finite, or beyond {FARTHEST:g}")
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or (matrix[2] != (0.0, 0.0, 1.0)).any() or matrix[1, 0] != 0:
            raise ShotError(
                f"the camera's intrinsics in frame {frame} are {matrix.tolist()}, expected positive focal lengths on "
                "an upper triangular matrix with the last row 0, 0, 1"
            )


def check_shape(name: str, array: np.ndarray, expected: tuple[int, ...]) -> None:
    """``ShotError`` where an array has another shape."""
    if array.shape != expected:
        raise ShotError(f"{name} has the shape {array.shape}, expected {expected}")


def check_rigid(matrices: np.ndarray, frames: np.ndarray, names: list[str]) -> None:
    """``ShotError`` where one of ``matrices`` [F, K, 4, 4] is not rigid, by the K things' names and the frame."""
    finite = np.isfinite(matrices).all(axis=(-1, -2))
    if not finite.all():
        frame, item = np.argwhere(~finite)[0]
        raise ShotError(f"{names[item]} in frame {frames[frame]} has a matrix that is not finite; check its animation")
    near = (np.abs(matrices) <= FARTHEST).all(axis=(-1, -2))
    if not near.all():
        frame, item = np.argwhere(~near)[0]
        raise ShotError(
            f"{names[item]} in frame {frames[frame]} lies farther than {FARTHEST:g} m from the origin; check "
            "its animation"
        )
    rotation = matrices[..., :3, :3]
    gram = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(axis=(-1, -2), initial=0.0)
    last = np.abs(matrices[..., 3, :] - (0.0, 0.0, 0.0, 1.0)).max(axis=-1, initial=0.0)
    error = np.maximum(gram, last)
    mirrored = np.linalg.det(rotation) < 0
    wrong = (error > RIGID_TOLERANCE) | mirrored
    if wrong.any():
        frame, item = np.argwhere(wrong)[0]
        cause = "is mirrored" if mirrored[frame, item] else f"is scaled or sheared (by {error[frame, item]:.3g})"
        raise ShotError(
            f"{names[item]} in frame {frames[frame]} {cause}, expected a rigid matrix to {RIGID_TOLERANCE:g}; apply "
            "its scale in Blender"
        )

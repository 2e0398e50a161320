"""From Blender's matrices, which may scale and shear, to rigid frames; what is dropped is reported or refused.

A linear map ``L`` is split by polar decomposition, ``L = R S``: ``R`` is the rotation nearest to ``L``, ``S`` the
stretch.  One uniform scale is kept for the whole figure; what remains of ``S`` is dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import ChonaError

STRETCH_LIMIT = 0.1
"""Largest stretch of a bone relative to the figure that is dropped; more is refused."""

REPORT_FROM = 1e-3
"""Smaller stretches are rounding and are not reported."""

_SINGULAR = 1e-6


@dataclass(frozen=True)
class Dropped:
    """What was dropped of one bone or object in its worst frame.

    Attributes:
        name: bone or object.
        frame: scene frame.
        scale: its mean scale relative to the figure's.
        shear: largest over smallest stretch, minus 1 (non-uniform scale or shear).
    """

    name: str
    frame: int
    scale: float
    shear: float

    def __str__(self) -> str:
        return f"'{self.name}' in frame {self.frame}: scale {self.scale:.3f}, shear {100 * self.shear:.1f} %"


@dataclass(frozen=True)
class Stretches:
    """Linear maps [F, J, 3, 3] looked at: what is wrong with which.

    Attributes:
        values: [F, J, 3] stretches, the largest first; 1 where a map is not finite.
        finite, flat, mirrored: [F, J] bool; flat maps have no extent along an axis.
    """

    values: np.ndarray
    finite: np.ndarray
    flat: np.ndarray
    mirrored: np.ndarray


def stretches(linear: np.ndarray) -> Stretches:
    """The stretches of linear maps [F, J, 3, 3]."""
    finite = np.isfinite(linear).all(axis=(-1, -2))
    safe = np.where(finite[..., None, None], linear, np.eye(3))
    values = np.linalg.svd(safe, compute_uv=False)
    flat = values[..., 2] <= _SINGULAR * np.maximum(values[..., 0], _SINGULAR)
    return Stretches(values, finite, flat, np.linalg.det(safe) < 0)


def check_matrices(linear: np.ndarray, kind: str, names: Sequence[str], frames: Sequence[int]) -> None:
    """Refuses what has no nearest rotation.

    Args:
        linear: [F, J, 3, 3].
        kind: 'Bone' or 'Object', for messages.

    Raises:
        ChonaError: a value that is not finite, a zero scale or a mirrored axis, by name and frame.
    """
    seen = stretches(linear)
    problems = (
        (~seen.finite, "has a value that is not finite", "check its constraints and drivers"),
        (seen.flat, "has zero scale along an axis", "give it a scale above zero"),
        (seen.mirrored, "is mirrored (a negative scale)", "apply or remove the negative scale"),
    )
    for found, what, remedy in problems:
        if found.any():
            frame, index = np.argwhere(found)[0]
            raise ChonaError(f"{kind} '{names[index]}' {what} in frame {frames[frame]}: {remedy}")


def figure_scale(linear: np.ndarray) -> float:
    """The one uniform scale of a figure: the median of the cube roots of the determinants of [F, J, 3, 3]."""
    if linear.size == 0:
        return 1.0
    scale = float(np.median(np.cbrt(np.abs(np.linalg.det(linear)))))
    return 1.0 if abs(scale - 1.0) < 1e-5 else scale


def project_rotations(
    linear: np.ndarray,
    scale: float,
    kind: str,
    *,
    names: Sequence[str],
    frames: Sequence[int],
    limit: float | None = STRETCH_LIMIT,
) -> tuple[np.ndarray, list[Dropped]]:
    """The rotations nearest to linear maps.

    Args:
        linear: [F, J, 3, 3]; checked with ``check_matrices`` here.
        scale: the figure's uniform scale, divided out before.
        kind: 'Bone' or 'Object', for messages.
        limit: largest stretch that is dropped; None drops any.

    Returns:
        rotations [F, J, 3, 3], determinant +1; and what was dropped, one entry a name, the worst first.

    Raises:
        ChonaError: not finite, zero scale, mirrored, or a stretch past the limit, by name and frame.
    """
    check_matrices(linear, kind, names, frames)
    left, stretch, right = np.linalg.svd(linear / scale)
    rotations = left @ right  # both factors have the same handedness: check_matrices refuses negative determinants
    if rotations.size == 0:
        return rotations, []
    worst = np.abs(stretch - 1.0).max(axis=-1)
    dropped = []
    for index, name in enumerate(names):
        frame = int(worst[:, index].argmax())
        amount = stretch[frame, index]
        if worst[frame, index] > REPORT_FROM:
            dropped.append(Dropped(name, int(frames[frame]), float(amount.mean()), float(amount[0] / amount[2] - 1.0)))
    dropped.sort(key=lambda each: -max(abs(each.scale - 1.0), each.shear))
    if limit is not None and worst.max() > limit:
        frame, index = np.unravel_index(int(worst.argmax()), worst.shape)
        low, high = stretch[frame, index, 2], stretch[frame, index, 0]
        figure = "the figure's" if abs(scale - 1.0) < 1e-5 else f"the figure's ({scale:.3g})"
        raise ChonaError(
            f"{kind} '{names[index]}' is stretched to {low:.3g}–{high:.3g} times {figure} scale in frame "
            f"{frames[frame]}; up to {100 * limit:.0f} % is dropped silently. Set its scale to 1 or remove what "
            "stretches it"
        )
    return rotations, dropped

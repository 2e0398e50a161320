"""How an armature's rest pose lies in canonical space: its axes and its unit of length.

An armature that this add-on makes is in metres, z up, facing −y (``Rx(90°)`` of canonical space).  Imported ones may be
y up or in centimetres under an object of scale 0.01: both are found by comparing bone heads with rest joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from bpy.types import Object

from ..errors import ChonaError

RX90 = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Blender's world (z up) from canonical space (y up)."""

SCALED_COPY_ERROR = 1e-3
"""Heads that fit the rest joints this well (relative) after scaling are a scaled copy, not another body."""


@dataclass(frozen=True)
class RestPose:
    """Rest pose of B mapped bones.

    Attributes:
        bones: names in the armature, in the order of the skeleton.
        matrices: [B, 4, 4] ``matrix_local``, armature space from bone.
        rotation: [3, 3] armature axes from canonical axes.
        scale: armature units in one metre of canonical space.
    """

    bones: tuple[str, ...]
    matrices: np.ndarray
    rotation: np.ndarray
    scale: float

    @property
    def heads(self) -> np.ndarray:
        """[B, 3] bone heads in armature space."""
        return self.matrices[:, :3, 3]

    @property
    def canonical_joints(self) -> np.ndarray:
        """[B, 3] bone heads in canonical axes, metres."""
        return self.heads @ self.rotation / self.scale


def rest_matrices(armature: Object, bones: Sequence[str]) -> np.ndarray:
    """[B, 4, 4] rest matrices (``matrix_local``) in armature space, float64."""
    return np.array([armature.data.bones[name].matrix_local for name in bones], dtype=np.float64).reshape(-1, 4, 4)


def axis_rotations() -> list[np.ndarray]:
    """The 24 rotations that permute axes, ``RX90`` first."""
    rotations = [RX90, np.eye(3)]
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                rotations.append(matrix)
    return rotations


def model_rest_pose(armature: Object, bones: Sequence[str], rest_joints: np.ndarray) -> RestPose:
    """Rest pose of an armature that poses a model's person.

    Args:
        bones: B names in the armature, in the order of the skeleton.
        rest_joints: [B, 3] canonical joints of the person, metres.

    Raises:
        ChonaError: all bones of the armature start in one point.
    """
    matrices = rest_matrices(armature, bones)
    heads = matrices[:, :3, 3] - matrices[:, :3, 3].mean(axis=0)
    joints = rest_joints - rest_joints.mean(axis=0)
    length = np.linalg.norm(joints)
    if length < 1e-9:  # one bone: nothing to compare with
        return RestPose(tuple(bones), matrices, RX90, 1.0)
    if np.linalg.norm(heads) < 1e-9:
        raise ChonaError(
            f"All bones of armature '{armature.name}' start in the same point, the model's spread over "
            f"{length:.2f} m. Choose another armature or another bone mapping"
        )
    best, best_scale, best_error = fit_axes(joints, heads)
    if best_error > SCALED_COPY_ERROR and 0.8 < best_scale < 1.25:
        best_scale = 1.0  # another body in metres
    if best_scale <= 0.0 or abs(best_scale - 1.0) < 1e-5:
        best_scale = 1.0
    return RestPose(tuple(bones), matrices, best, best_scale)


def fit_axes(joints: np.ndarray, heads: np.ndarray) -> tuple[np.ndarray, float, float]:
    """The axes and the unit in which bone heads lie like joints.

    Args:
        joints, heads: [B, 3] about their means, canonical and armature space.

    Returns:
        rotation [3, 3] that permutes axes, scale, and the relative error of the fit.
    """
    best, best_error, best_scale = RX90, np.inf, 1.0
    for rotation in axis_rotations():
        turned = joints @ rotation.T
        scale = max((turned * heads).sum() / (turned * turned).sum(), 0.0)
        error = float(np.linalg.norm(heads - scale * turned) / np.linalg.norm(heads))
        if error < best_error - 1e-6:  # an earlier one wins where several fit, Blender's usual axes first
            best, best_error, best_scale = rotation, error, float(scale)
    return best, best_scale, best_error


def captured_rest_pose(armature: Object, bones: Sequence[str], metres_per_unit: float, axes: str = "AUTO") -> RestPose:
    """Rest pose of a character that is captured: its own rest bones define canonical space.

    Args:
        bones: B names in the armature, in the order of the skeleton.
        metres_per_unit: scale of the armature in the world.
        axes: ``Z_UP`` (facing −y), ``Y_UP`` (facing +z) or ``AUTO``, which takes y up only where the bones spread over
            y more than twice as far as over z (imports from other programs).

    Raises:
        ChonaError: an unknown value of ``axes``.
    """
    matrices = rest_matrices(armature, bones)
    if axes not in {"AUTO", "Z_UP", "Y_UP"}:
        raise ChonaError(f"Axes of the armature are '{axes}', expected AUTO, Z_UP or Y_UP")
    extent = np.ptp(matrices[:, :3, 3], axis=0)
    y_up = axes == "Y_UP" or (axes == "AUTO" and extent[1] > 2.0 * extent[2])
    return RestPose(tuple(bones), matrices, np.eye(3) if y_up else RX90, 1.0 / metres_per_unit)

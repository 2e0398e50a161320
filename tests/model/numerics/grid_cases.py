"""A small grid model that shows something without being trained, and poses at the ends of what can be posed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from tiny_capture import tiny_capture
from tiny_models import tiny_trainer

from chona_model.data.dataset import Pose, View
from chona_model.grid_model import GridModel
from chona_model.kernels.grid import encode

SOLID = 3.0
"""Added to the density's bias: some 30/m, opaque over a body's thickness."""


@cache
def scene() -> tuple[GridModel, View]:
    """Random colours inside the masks' visual hull, an offset that is seen, and a view."""
    torch.manual_seed(0)
    dataset = tiny_capture(Path(mkdtemp()), frames=2, cameras=4, size=(24, 18))
    model = tiny_trainer(dataset).model.eval()
    with torch.no_grad():
        model.field.table.uniform_(-1.0, 1.0)
        model.field.density_out.bias[0] += SOLID
        model.volume(0).offset_shapes.normal_(0.0, 0.01)
    return model, dataset.views[1]


def turned(pose: Pose, bone: int, matrix: np.ndarray, below: bool = True) -> Pose:
    """The pose with the linear part of a bone (and of those below it in a chain) replaced by matrix @ itself."""
    bones = pose.world_from_bone.copy()
    for index in range(bone, len(bones) if below else bone + 1):
        bones[index, :3, :3] = matrix @ bones[index, :3, :3]
    return replace(pose, world_from_bone=bones)


def placed(pose: Pose, offset: tuple[float, ...]) -> Pose:
    """The pose with its object moved to an offset from the root bone, metres."""
    things = pose.world_from_object.copy()
    things[:, :3, 3] = pose.world_from_bone[0, :3, 3] + offset
    return replace(pose, world_from_object=things)


def _turn(angle: float, axis: int) -> np.ndarray:
    return Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()


POSES: dict[str, Callable[[Pose], Pose]] = {
    "as it is": lambda pose: pose,
    "opposed": lambda pose: turned(pose, 1, _turn(np.pi, 0)),
    "twisted": lambda pose: turned(pose, 2, _turn(np.pi, 2)),
    "twisted less": lambda pose: turned(pose, 1, _turn(np.pi - 1e-6, 1)),
    "hardly turned": lambda pose: turned(pose, 1, _turn(1e-8, 1)),
    "mirrored": lambda pose: turned(pose, 1, np.diag([-1.0, 1.0, 1.0])),
    "zero": lambda pose: turned(pose, 1, np.zeros((3, 3))),
    "tiny": lambda pose: turned(pose, 1, 1e-12 * np.eye(3)),
    "sheared": lambda pose: turned(pose, 2, np.array([[1.0, 5.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])),
    "duplicated": lambda pose: replace(pose, world_from_bone=pose.world_from_bone[[0, 1, 1]]),
    "object far": lambda pose: placed(pose, (50.0, 0.0, 0.0)),
    "object farther": lambda pose: placed(pose, (1e4, 0.0, 0.0)),
    "object inside": lambda pose: placed(pose, (0.0, 0.0, 0.0)),
    "object absent": lambda pose: replace(pose, objects=(), world_from_object=np.zeros((0, 4, 4))),
    "person absent": lambda pose: replace(pose, person=None, world_from_bone=np.zeros((0, 4, 4))),
}
"""Poses that shots refuse in part, but which must not break the model."""


def encoded(model: GridModel, points: torch.Tensor, part: torch.Tensor) -> torch.Tensor:
    """The field's features of points in their parts' frames."""
    local = points - model.field.lower[part.long()]
    return encode(local, part, model.field.table.detach(), model.field.layout)

"""People and objects of a grid model, for stand-ins."""

from __future__ import annotations

import numpy as np
import torch

from chona_model.data.dataset import Pose
from chona_model.deform.voxels import NodeGrid
from chona_model.grid_model import GridModel


class GridPart:
    """A part of a grid model.

    Args:
        model: on any device.
        kind: ``person`` or ``object``; name: of the identity.
        pose: the canonical pose with everything that is shown together; codes and occlusion are this pose's.
    """

    def __init__(self, model: GridModel, kind: str, name: str, pose: Pose) -> None:
        self.model, self.kind, self.name = model, kind, name
        posed = model.posed(pose)
        is_person = kind == "person"
        number = model.person_index(name) if is_person else model.object_index(name)
        self.number, self.part = number, number if is_person else len(model.persons) + number
        thing = next(iter(posed.objects), -1) if is_person else number
        pair = model.pair(posed.person, thing, of_object=not is_person)
        self._pairs = torch.tensor([pair], device=model.device)
        self._code = model.real(posed.code[None])
        self.lower, self.upper = model.boxes[0][self.part], model.boxes[1][self.part]
        self._weights = model.volume(number).weights().detach().float().cpu().numpy() if is_person else None

    def holds(self, points: np.ndarray) -> np.ndarray:
        occupancy = self.model.occupancy
        nx, ny, nz = occupancy.dims[self.part]
        cells = np.floor((points - occupancy.origins[self.part]) / occupancy.cell).astype(np.int64)
        inside = ((cells >= 0) & (cells < (nx, ny, nz))).all(axis=1)
        x, y, z = np.where(inside[:, None], cells, 0).T
        return inside & (occupancy.part(self.part)[x + nx * (y + ny * z)] > 0)

    def density(self, points: np.ndarray, width: float) -> np.ndarray:  # noqa: ARG002 – grids have no mip levels
        count = len(points)
        found = self.model.field.density(
            self.model.real(points), torch.full((count,), self.part, dtype=torch.int32, device=self.model.device),
            self._pairs, torch.zeros(count, dtype=torch.int64, device=self.model.device),
        )  # fmt: skip
        return found.float().cpu().numpy()

    def colour(self, points: np.ndarray, width: float) -> np.ndarray:  # noqa: ARG002
        count, device = len(points), self.model.device
        none = torch.zeros(count, dtype=torch.int64, device=device)
        with torch.no_grad():
            part = torch.full((count,), self.part, dtype=torch.int32, device=device)
            rgb = self.model.field(self.model.real(points), part, self._pairs, none, self._code, none)[1]
        return rgb.float().cpu().numpy()

    def weights(self, points: np.ndarray) -> np.ndarray:
        if self._weights is None:
            return np.zeros((len(points), 0), dtype=np.float32)
        return interpolate(self.model.grid(self.number), self._weights, points)


def interpolate(grid: NodeGrid, values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values [M, K] on a grid's nodes at points [N, 3], trilinearly; points outside take the border's."""
    place = np.clip((points - grid.origin) / grid.cell, 0.0, grid.dims - 1.0 - 1e-6)
    lower = place.astype(np.int64)
    share = place - lower
    total = np.zeros((len(points), values.shape[1]), dtype=np.float64)
    for corner in np.ndindex(2, 2, 2):
        x, y, z = (lower + corner).T
        weight = np.where(np.array(corner, dtype=bool), share, 1.0 - share).prod(axis=1)
        total += weight[:, None] * values[grid.nodes[x + grid.dims[0] * (y + grid.dims[1] * z)]]
    return total

"""Recovery of known roots by the voxel path of preset fast: the starts of posed cells, Newton in blended matrices.

Its map is not quite that of the others: the same weights, read off at nodes 3 cm apart and interpolated.  Its known
roots are posed by its own map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from benchmarks.recovery_cases import AROUND, Body, body_points
from chona_model.deform.voxels import SkinningVolume, initial_weights, make_node_grid
from chona_model.grid_inputs import starts_of
from chona_model.grid_model import GridModelShape
from chona_model.grid_view import ACCEPT, LONGEST
from chona_model.kernels.cpu import newton, skinning
from chona_model.kernels.cpu.jit import entry
from chona_model.render.occupancy import PartCells
from chona_model.render.posed import POSED_CELL, PosedPart, pose_cells
from chona_model.settings import RenderSettings

MARGIN = 0.25
"""Of the canonical box around the body, metres."""


@entry
def search(posed, first, starts, volume, limits, roots, residuals):  # type: ignore[no-untyped-def]
    """Newton from starts [M, chances, 3] to points [M, 3]; chances a point does not have are not followed."""
    work = np.empty(newton.WORK, np.float32)
    for m in range(len(posed)):
        for chance in range(first[m]):
            x, y, z, residual = newton.find_root(
                posed[m, 0], posed[m, 1], posed[m, 2], starts[m, chance, 0], starts[m, chance, 1],
                starts[m, chance, 2], volume, limits, work,
            )  # fmt: skip
            roots[m, chance, 0], roots[m, chance, 1], roots[m, chance, 2] = x, y, z
            residuals[m, chance] = residual


@dataclass(frozen=True)
class VoxelBody:
    """A body's skinning nodes, and its occupied cells: all within reach of its surface or bones."""

    body: Body
    volume: SkinningVolume
    cells: PartCells

    @classmethod
    def of(cls, body: Body) -> VoxelBody:
        """Nodes as ``GridModel`` has them, weights as for ``distance_weights``."""
        tails = body.skeleton.bone_tails(body.joints)
        known = np.concatenate([body.joints, tails] if body.vertices is None else [body.joints, tails, body.vertices])
        lower, upper = known.min(axis=0) - MARGIN, known.max(axis=0) + MARGIN
        shape = GridModelShape()
        grid = make_node_grid(lower, upper, shape.node_cell, body.joints, tails, shape.node_reach, None)
        volume = SkinningVolume(grid, len(body.joints), 1, 0)
        volume.initialise(initial_weights(grid.points, body.joints, tails, None))
        axes = [np.arange(lower[k], upper[k], shape.occupancy_cell) + 0.5 * shape.occupancy_cell for k in range(3)]
        centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        near = body_points(body, 200_000, np.random.default_rng(0))
        held = cKDTree(near).query(centres, distance_upper_bound=shape.occupancy_cell)[0] < AROUND
        chosen = centres[held].astype(np.float32)
        return cls(body, volume, PartCells(chosen, np.arange(len(chosen)), shape.occupancy_cell))

    def forward(self, x: np.ndarray, matrices: np.ndarray) -> np.ndarray:
        """Root-space places [M, 3] of canonical points."""
        grid, out = self.volume.grid, np.empty((len(x), 3), np.float32)
        inverse_cell = np.float32(1 / grid.cell)
        skinning.forward(x, matrices, grid.nodes, grid.dims, grid.origin.astype(np.float32), inverse_cell, out)
        return out

    @torch.no_grad()
    def find(
        self, transforms: torch.Tensor, x: np.ndarray, settings: RenderSettings
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Looks for known points of one pose.

        Args:
            transforms: [B, 4, 4] float32; x: [M, 3] float32 canonical points; settings: how it searches.

        Returns:
            whether each was found, whether anything was accepted as its root, whether its cell had starts: [M] bool.
        """
        matrices = self.volume.blend_padded(transforms, None).numpy()
        grid, real = self.volume.grid, np.float32
        part = pose_cells(self.cells, [], self.forward(self.cells.centres, matrices), self.cells.cell)
        posed = self.forward(x, matrices)
        first, starts = _starts_at(part, posed)
        roots, residuals = np.zeros_like(starts), np.full(starts.shape[:2], np.inf, real)
        volume = newton.Volume(matrices, grid.nodes, grid.dims, grid.origin.astype(real), real(1 / grid.cell))
        limits = newton.RootLimits(settings.newton_steps, real(settings.tolerance), real(LONGEST), real(ACCEPT))
        search(posed, first, starts, volume, limits, roots, residuals)
        accepted = residuals <= ACCEPT
        # Accepted residuals are up to 2 mm here, and canonical errors as large.
        near = (np.linalg.norm(roots - x[:, None], axis=-1) < ACCEPT) & accepted
        return near.any(axis=1), accepted.any(axis=1), first > 0


def _starts_at(part: PosedPart, posed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many starts [M] the posed points' cells have, and the starts [M, chances, 3]."""
    starts = starts_of(part)
    cell = np.floor((posed - part.origin) / POSED_CELL).astype(np.int64)
    inside = ((cell >= 0) & (cell < part.dims)).all(axis=1)
    flat = np.where(inside, cell[:, 0] + part.dims[0] * (cell[:, 1] + part.dims[1] * cell[:, 2]), 0)
    row = np.where(inside, starts.row[flat], -1)
    first = (part.starts[flat] >= 0).sum(axis=1)
    return np.where(row >= 0, first, 0), starts.points[np.maximum(row, 0)].copy()

"""A grid model's parts as the fused kernels take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels.cpu import advance, newton
from chona_model.kernels.cpu import trace as fused
from chona_model.render.normals import surface_normals
from chona_model.render.occupancy import Occupancy, coarser_cells
from chona_model.render.posed import POSED_CELL, PosedPart

APART = 0.01
"""Roots of one sample nearer than this are one, metres."""


def starts_of(part: PosedPart) -> advance.Starts:
    """A posed start grid."""
    marked = np.flatnonzero(part.starts[:, 0] >= 0)
    row, starts = np.full(len(part.starts), -1, dtype=np.int32), part.starts[marked]
    row[marked] = np.arange(len(marked), dtype=np.int32)
    # Column by column: reductions over two columns are slow.
    present = [(column >= 0).view(np.uint8) for column in starts.T]
    count = np.add.reduce(present, dtype=np.uint8)
    points = part.centres[np.maximum(starts, 0)] if len(marked) else np.zeros((1, starts.shape[1], 3), np.float32)
    return advance.Starts(row, count, points, part.dims, part.origin, np.float32(1 / POSED_CELL))


@dataclass(frozen=True)
class Surfaces:
    """What is kept of every part's cells.

    Attributes:
        occupied: [cells] uint8: a quarter of the memory of densities, which rays would otherwise go through.
        normals: [cells, 3] float32 (see ``surface_normals``).
    """

    occupied: np.ndarray
    normals: np.ndarray


def surfaces_of(occupancy: Occupancy) -> Surfaces:
    """The occupied cells as they are now, and which way their surfaces face."""
    return Surfaces(occupied_cells(occupancy), surface_normals(occupancy))


def surfaces_for(occupancy: Occupancy, trained: Occupancy, coarser: int) -> Surfaces:
    """Cells of an ``occupancy`` made of the ``trained`` one, ``coarser`` of its cells to one along each axis.

    Surfaces face where the trained ones face: which cells are sampled is not to change how anything is lit.
    """
    return Surfaces(occupied_cells(occupancy), coarser_cells(surface_normals(trained), trained, coarser))


def occupied_cells(occupancy: Occupancy) -> np.ndarray:
    """[cells] uint8 of all parts."""
    return (occupancy.densities > 0).view(np.uint8)


def parts_of(
    model: GridModel, posed: PosedFigure, occupancy: Occupancy, surfaces: Surfaces, light: np.ndarray
) -> advance.Parts:
    """The parts that a pose shows, where they are and how they are lit; empty object slots are not among them.

    Args:
        light: [9, 3] of the pose (see ``GridModel.root_light``).
    """
    shown = len(posed.objects)
    return advance.Parts(
        surfaces.occupied, occupancy.first, occupancy.dims, occupancy.origins, np.float32(1 / occupancy.cell),
        surfaces.normals, light, posed.person, model.slot_parts(posed)[:shown],
        np.ascontiguousarray(posed.slots[:shown]),
    )  # fmt: skip


def volume_of(model: GridModel, posed: PosedFigure, matrices: np.ndarray) -> newton.Volume:
    """Blended matrices [M, 16] of a pose on its person's grid; a stand-in where there is no person."""
    if posed.person < 0:
        nodes, dims = np.zeros(1, dtype=np.int32), np.full(3, 2, dtype=np.int64)
        return newton.Volume(np.zeros((1, 16), np.float32), nodes, dims, np.zeros(3, np.float32), np.float32(1.0))
    grid = model.grid(posed.person)
    origin, inverse_cell = grid.origin.astype(np.float32), np.float32(1 / model.shape.node_cell)
    return newton.Volume(matrices, grid.nodes, grid.dims, origin, inverse_cell)


def tables_of(model: GridModel) -> fused.Tables:
    """The field's grids."""
    field = model.field
    layout, scale = field.layout.arguments(), np.float32(field.shape.density_scale)
    return fused.Tables(field.table_of.numpy(), field.table.detach().numpy(), field.lower.numpy(), *layout, scale)


def limits_of(step: float, stop: float, steps: int, tolerance: float, longest: float, accept: float) -> fused.Limits:
    """Distance between samples and transmittance that ends a ray; Newton's limits (see ``newton.RootLimits``)."""
    real = np.float32
    return fused.Limits(
        real(step), real(stop), real(APART), newton.RootLimits(steps, real(tolerance), real(longest), real(accept))
    )

"""A pose made ready to be looked at, and the view of a camera on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from chona_model.camera import Camera
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels.cpu import advance, newton
from chona_model.kernels.cpu import perceptron as kernels
from chona_model.kernels.cpu import render as fused
from chona_model.kernels.perceptron import pack
from chona_model.kernels.threads import in_pieces
from chona_model.render.occupancy import Occupancy, PartCells
from chona_model.render.posed import POSED_CELL, PosedPart, depth_spans
from chona_model.settings import RenderSettings

cpu: Any = fused

PIECE = 256
"""Pixels a thread takes at once: some ten milliseconds of work."""

TOLERANCE, LONGEST, ACCEPT, APART = 2e-4, 0.05, 0.002, 0.01
"""Metres: residual that ends Newton's method, its longest step, residual still accepted; roots nearer are one."""


@dataclass(frozen=True)
class ReadyPose:
    """Everything of a pose that no camera changes, as the kernel takes it."""

    figure: PosedFigure
    part: PosedPart
    volume: newton.Volume
    starts: advance.Starts
    parts: advance.Parts
    network: kernels.Network


@dataclass(frozen=True)
class View:
    """What rays found.

    Attributes:
        rows, columns: [R] pixels that were looked at; values: [R, COLUMNS] means over their rays, but sums of the last
            two (see ``kernels.cpu.advance.COLUMNS``).
        evaluated: how often the field was evaluated.
    """

    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    evaluated: int


def make_ready(
    model: GridModel, posed: PosedFigure, occupancy: Occupancy, cells: Sequence[PartCells], offset: bool, shading: bool
) -> ReadyPose:
    """Blends the pose's matrices, marks its start grid and packs its conditioned weights.

    Args:
        occupancy: which cells to sample; cells: of every part.
        offset, shading: whether F_Δ and the ambient occlusion are applied.
    """
    real = np.float32
    with torch.inference_mode():
        matrices, nodes, dims, origin = _volume(model, posed, offset)
        things = posed.objects or (-1,)
        codes = model.field.codes(torch.tensor([[posed.person, thing] for thing in things]))
        pose_code = torch.as_tensor(posed.code[None], dtype=torch.float32) if shading else None
        network = pack(model.field.weights(codes, pose_code))
    part = model.pose_cells(posed, cells, matrices)
    slots = model.shape.object_slots
    slot_part = np.full(slots, -1, dtype=np.int32)
    slot_part[: len(posed.objects)] = [len(model.persons) + thing for thing in posed.objects]
    return ReadyPose(
        posed, part, newton.Volume(matrices, nodes, dims, origin, real(1 / model.shape.node_cell)),
        advance.Starts(
            (part.starts[:, 0] >= 0).view(np.uint8), part.starts, part.centres, part.dims, part.origin,
            real(1 / POSED_CELL),
        ),
        advance.Parts(
            occupancy.densities, occupancy.first, occupancy.dims, occupancy.origins, real(1 / occupancy.cell),
            posed.person, slot_part, np.ascontiguousarray(posed.slots).reshape(slots, 3, 4),
        ),
        network,
    )  # fmt: skip


def _volume(
    model: GridModel, posed: PosedFigure, offset: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    if posed.person < 0:
        none = np.zeros(1, dtype=np.int32)
        return np.zeros((1, 16), np.float32), none, np.full(3, 2, dtype=np.int64), np.zeros(3, np.float32)
    grid = model.grid(posed.person)
    codes = torch.as_tensor(posed.code[None], dtype=torch.float32) if offset else None
    transforms = torch.from_numpy(posed.figure.transforms[: len(model.skeleton)].astype(np.float32))
    matrices = model.volume(posed.person).blend_padded(transforms, codes).numpy()
    return matrices, grid.nodes, grid.dims, grid.origin.astype(np.float32)


def render_view(model: GridModel, ready: ReadyPose, camera: Camera, settings: RenderSettings) -> View:
    """Traces every pixel that the pose's occupied cells may be seen in."""
    real = np.float32
    near, far = depth_spans(ready.part, ready.figure.figure, camera)
    rows, columns = np.nonzero(far > near)
    origins, directions = ready.figure.figure.rays(camera, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    lens = np.stack([origins[0], directions[0], directions[1] - directions[0], directions[2] - directions[0]])
    rays = advance.Rays(
        np.stack([columns, rows], axis=-1).astype(np.int32), near[rows, columns], far[rows, columns],
        lens.astype(real), (origins[1:] - origins[0]).astype(real), settings.supersampling,
    )  # fmt: skip
    limits = fused.Limits(
        real(settings.step), real(settings.stop), real(APART),
        newton.RootLimits(settings.newton_steps, real(TOLERANCE), real(LONGEST), real(ACCEPT)),
    )  # fmt: skip
    field, layout = model.field, model.field.layout
    tables = fused.Tables(
        field.table.detach().numpy(), field.lower.numpy(), *layout.arguments(), real(field.shape.density_scale)
    )
    out = np.zeros((len(rows), advance.COLUMNS), dtype=real)
    rest = (rays, ready.volume, ready.starts, ready.parts, tables, ready.network, limits, out)
    evaluated = in_pieces(lambda begin, end: cpu.render(begin, end, *rest), len(rows), PIECE)
    out[:, :6] /= settings.supersampling**2
    return View(rows, columns, out, sum(evaluated))

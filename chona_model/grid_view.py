"""A pose made ready to be looked at, and the view of a camera on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from chona_model.camera import Camera
from chona_model.grid_inputs import Surfaces, limits_of, parts_of, starts_of, tables_of, volume_of
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels.cpu import advance, newton
from chona_model.kernels.cpu import perceptron as kernels
from chona_model.kernels.cpu import render as fused
from chona_model.kernels.perceptron import pack
from chona_model.kernels.threads import in_pieces
from chona_model.render.occupancy import Occupancy, PartCells
from chona_model.render.posed import PosedPart, Window, depth_spans
from chona_model.settings import RenderSettings

cpu: Any = fused

PIECE = 256
"""Pixels a thread takes at once: some ten milliseconds of work."""

TOLERANCE, LONGEST, ACCEPT = 2e-4, 0.05, 0.002
"""Metres: residual that ends Newton's method, its longest step, residual still accepted."""


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
    model: GridModel, posed: PosedFigure, occupancy: Occupancy, surfaces: Surfaces, cells: Sequence[PartCells],
    offset: bool, shading: bool,
) -> ReadyPose:  # fmt: skip
    """Blends the pose's matrices, marks its start grid and packs its conditioned weights.

    Args:
        occupancy, surfaces: which cells to sample; cells: of every part.
        offset, shading: whether F_Δ and the ambient occlusion are applied.
    """
    with torch.inference_mode():
        matrices = model.rendering_matrices(posed, offset).numpy()
        things = posed.objects or (-1,)
        codes = model.field.codes(torch.tensor([[posed.person, thing] for thing in things]))
        pose_code = torch.as_tensor(posed.code[None], dtype=torch.float32) if shading else None
        network = pack(model.field.weights(codes, pose_code))
        light = model.root_light([posed])[0].numpy()
    part = model.pose_cells(posed, cells, matrices)
    volume, parts = volume_of(model, posed, matrices), parts_of(model, posed, occupancy, surfaces, light)
    return ReadyPose(posed, part, volume, starts_of(part), parts, network)


def render_view(model: GridModel, ready: ReadyPose, camera: Camera, settings: RenderSettings, window: Window) -> View:
    """Traces every pixel of a window that the pose's occupied cells may be seen in."""
    real = np.float32
    near, far = depth_spans(ready.part, ready.figure.figure, camera, window)
    where = np.nonzero(far > near)
    near, far, rows, columns = near[where], far[where], where[0] + window.top, where[1] + window.left
    origins, directions = ready.figure.figure.rays(camera, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    lens = np.stack([origins[0], directions[0], directions[1] - directions[0], directions[2] - directions[0]])
    rays = advance.Rays(
        np.stack([columns, rows], axis=-1).astype(np.int32), near, far,
        lens.astype(real), (origins[1:] - origins[0]).astype(real), settings.supersampling,
    )  # fmt: skip
    limits = limits_of(settings.step, settings.stop, settings.newton_steps, TOLERANCE, LONGEST, ACCEPT)
    out = np.zeros((len(rows), advance.COLUMNS), dtype=real)
    rest = (rays, ready.volume, ready.starts, ready.parts, tables_of(model), ready.network, limits, out)
    evaluated = in_pieces(lambda begin, end: cpu.render(begin, end, *rest), len(rows), PIECE)
    out[:, :6] /= settings.supersampling**2
    return View(rows, columns, out, sum(evaluated))

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
from chona_model.kernels.cpu import sample as tracing_kernels
from chona_model.kernels.cpu.sample import GivenRays
from chona_model.kernels.perceptron import pack
from chona_model.kernels.threads import in_pieces
from chona_model.render.occupancy import Occupancy, PartCells
from chona_model.render.posed import PosedPart, Window, depth_spans
from chona_model.settings import RenderSettings

cpu: Any = tracing_kernels

PIECE = 256
"""Pixels a thread takes at once: some ten milliseconds of work."""

LONGEST, ACCEPT = 0.05, 0.002
"""Metres: the longest step of Newton's method, the residual still accepted."""


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
    settings: RenderSettings,
) -> ReadyPose:  # fmt: skip
    """Blends the pose's matrices, marks its start grid and packs its conditioned weights.

    Args:
        occupancy, surfaces: which cells to sample; cells: of every part.
        settings: of which the offset, the occlusion and the number of starts concern a pose.
    """
    with torch.inference_mode():
        matrices = model.rendering_matrices(posed, settings.offset).numpy()
        things = posed.objects or (-1,)
        codes = model.field.codes(torch.tensor([[posed.person, thing] for thing in things]))
        pose_code = torch.as_tensor(posed.code[None], dtype=torch.float32) if settings.shading else None
        network = pack(model.field.weights(codes, pose_code))
        light = model.root_light([posed])[0].numpy()
    part = model.pose_cells(posed, cells, matrices, settings.starts)
    volume, parts = volume_of(model, posed, matrices), parts_of(model, posed, occupancy, surfaces, light)
    return ReadyPose(posed, part, volume, starts_of(part), parts, network)


def render_view(
    model: GridModel, ready: ReadyPose, camera: Camera, settings: RenderSettings, window: Window,
    pixels: np.ndarray | None = None,
) -> View:  # fmt: skip
    """Traces every pixel of a window that the pose's occupied cells may be seen in.

    Args:
        pixels: [H, W] bool of the whole image: only these. None: all.
    """
    real = np.float32
    near, far = depth_spans(ready.part, ready.figure.figure, camera, window)
    seen = far > near
    if pixels is not None:
        seen &= pixels[window.top : window.bottom, window.left : window.right]
    where = np.nonzero(seen)
    near, far, rows, columns = near[where], far[where], where[0] + window.top, where[1] + window.left
    origins, directions = ready.figure.figure.rays(camera, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    lens = np.stack([origins[0], directions[0], directions[1] - directions[0], directions[2] - directions[0]])
    places, lens = np.stack([columns, rows], axis=-1).astype(np.int32), lens.astype(real)
    drift, side = (origins[1:] - origins[0]).astype(real), settings.supersampling
    limits = limits_of(settings.step, settings.stop, settings.newton_steps, settings.tolerance, LONGEST, ACCEPT)
    out = np.empty((len(rows), advance.COLUMNS), dtype=real)
    rest = (ready.volume, ready.starts, ready.parts, tables_of(model), ready.network, limits)
    slots = np.arange(max(len(ready.parts.slot_part), 1))

    def look(begin: int, end: int) -> int:
        count = (end - begin) * side**2
        origin, direction = np.empty((2, count, 3), real)
        ray_near, ray_far = np.empty((2, count), real)
        cpu.aim(begin, places, near, far, lens, drift, side, origin, direction, ray_near, ray_far)
        pair = np.broadcast_to(slots, (count, len(slots))).copy()
        rays = GivenRays(origin, direction, ray_near, ray_far, np.full(count, 0.5, real), pair, 0)
        values = np.empty((count, advance.COLUMNS), real)
        evaluated = cpu.sample(0, count, False, rays, *rest, values)[0]
        of_pixels = values.reshape(end - begin, side**2, -1)
        out[begin:end, :6], out[begin:end, 6:] = of_pixels[..., :6].mean(axis=1), of_pixels[..., 6:].sum(axis=1)
        return evaluated

    evaluated = in_pieces(look, len(rows), PIECE)
    return View(rows, columns, out, sum(evaluated))

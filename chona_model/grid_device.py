"""Views of a grid model on a GPU: the stages of ``render.tracing`` over many rays at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from chona_model.actor import Samples
from chona_model.camera import Camera
from chona_model.grid_inputs import Surfaces
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.grid_view import ACCEPT, LONGEST, View
from chona_model.kernels.cpu.advance import COLUMNS
from chona_model.kernels.warp import NewtonLimits, VolumeIndex
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.render.occupancy import Occupancy, PartCells
from chona_model.render.posed import PosedPart, Window, depth_spans
from chona_model.render.tracing import PoseTable, RayRows, Traced, TraceSettings, make_pose_table, trace
from chona_model.samples import densest, join, no_samples
from chona_model.settings import RenderSettings

CHUNK = 1 << 18
"""Rays traced together: a few gigabytes of what lies between the stages."""


@dataclass(frozen=True)
class DevicePose:
    """Everything of a pose that no camera changes, on the model's device."""

    figure: PosedFigure
    part: PosedPart
    table: PoseTable
    matrices: Tensor
    index: VolumeIndex
    pairs: Tensor
    codes: Tensor | None
    lights: Tensor

    @property
    def parts_shown(self) -> int:
        """How many parts the pose has."""
        return (self.figure.person >= 0) + len(self.figure.objects)

    def part_of(self, slot: Tensor) -> Tensor:
        """Which part of the pose samples are on, whose object slot is [M], or −1 on the person."""
        return slot.long() + (self.figure.person >= 0)

    def in_world(self, normal: Tensor) -> np.ndarray:
        """Normals [M, 3] of root space in the world."""
        return self.figure.figure.turn_to_world(normal.cpu().numpy())


@torch.inference_mode()
def make_device_pose(
    model: GridModel, posed: PosedFigure, occupancy: Occupancy, surfaces: Surfaces, cells: Sequence[PartCells],
    settings: RenderSettings,
) -> DevicePose:  # fmt: skip
    """As ``grid_view.make_ready``."""
    matrices, index = model.matrices([posed], settings.offset)
    part = model.pose_cells(posed, cells, matrices.float().cpu().numpy(), settings.starts)
    table = make_pose_table(model, [posed], occupancy, surfaces.normals, [part])
    pairs = model.pairs(posed).to(model.device)
    codes = model.real(posed.code[None]) if settings.shading else None
    return DevicePose(posed, part, table, matrices, index, pairs, codes, model.root_light([posed]))


@dataclass(frozen=True)
class _Chunk:
    """Some pixels' rays through one point of each, traced: ``pixels`` [R] places among those looked at."""

    pixels: Tensor
    sub: int
    traced: Traced


def _trace_all(
    model: GridModel, ready: DevicePose, camera: Camera, settings: RenderSettings, rows: Tensor, columns: Tensor,
    spans: tuple[Tensor, Tensor], facing: bool,
) -> Iterator[_Chunk]:  # fmt: skip
    """All rays of pixels (rows, columns) [R], chunk by chunk."""
    near, far = spans
    side, real = settings.supersampling, near.dtype
    newton = NewtonLimits(settings.newton_steps, settings.tolerance, LONGEST)
    tracing = TraceSettings(settings.step, newton, ACCEPT, trust=0.0, stop=settings.stop)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    lens = [model.real(array) for array in ready.figure.figure.rays(camera, corners)]
    for sub in range(side**2):
        u, v = (sub % side + 0.5) / side, (sub // side + 0.5) / side
        for chunk in torch.arange(len(rows), device=rows.device).split(CHUNK):
            at = torch.stack([columns[chunk] + u, rows[chunk] + v], dim=-1).to(real)
            origins, directions = (a[0] + at @ (a[1:] - a[0]) for a in lens)
            count = len(chunk)
            rays = RayRows(
                origins.contiguous(), directions.contiguous(), near[chunk], far[chunk],
                near.new_full((count,), 0.5), torch.zeros(count, dtype=torch.int32, device=near.device),
                torch.arange(len(ready.pairs), device=near.device).expand(count, -1),
            )  # fmt: skip
            yield _Chunk(
                chunk, sub,
                trace(
                    model, ready.table, ready.matrices, ready.index, rays, ready.pairs, ready.codes, ready.lights,
                    tracing, facing,
                ),
            )  # fmt: skip


def _seen(
    model: GridModel, ready: DevicePose, camera: Camera, window: Window, pixels: np.ndarray | None
) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor]]:
    """Rows and columns [R] of the pixels to look at, and their near and far depths."""
    near, far = depth_spans(ready.part, ready.figure.figure, camera, window, model.real)
    seen = far > near
    if pixels is not None:
        wanted = pixels[window.top : window.bottom, window.left : window.right]
        seen &= torch.as_tensor(wanted, device=seen.device)
    rows, columns = seen.nonzero(as_tuple=True)
    return rows + window.top, columns + window.left, (near[rows, columns], far[rows, columns])


@torch.inference_mode()
def render_on_device(
    model: GridModel, ready: DevicePose, camera: Camera, settings: RenderSettings, window: Window,
    pixels: np.ndarray | None = None, passes: Passes = DEFAULT_PASSES,
) -> View:  # fmt: skip
    """As ``grid_view.render_view``."""
    rows, columns, spans = _seen(model, ready, camera, window, pixels)
    values, evaluated = spans[0].new_zeros(len(rows), COLUMNS), 0
    normal, parts = values.new_zeros(len(rows), 3), values.new_zeros(len(rows), ready.parts_shown)
    several = passes.cryptomatte and len(ready.figure.objects) > 1
    for chunk in _trace_all(model, ready, camera, settings, rows, columns, spans, passes.normal):
        values[chunk.pixels, :6] += chunk.traced.out / settings.supersampling**2
        values[chunk.pixels, 6] += chunk.traced.failed
        values[chunk.pixels, 7] += chunk.traced.tried
        evaluated += chunk.traced.evaluated
        found = chunk.traced.found
        pixel, weight = chunk.pixels[found.ray], found.weight / settings.supersampling**2
        if found.normal is not None:
            normal.index_add_(0, pixel, weight[:, None] * found.normal)
        if several:
            parts.index_put_((pixel, ready.part_of(found.slot)), weight, accumulate=True)
    return View(
        rows.cpu().numpy(), columns.cpu().numpy(), values.float().cpu().numpy(), evaluated,
        ready.in_world(normal) if passes.normal else None, parts.float().cpu().numpy() if several else None,
    )  # fmt: skip


@torch.inference_mode()
def sample_on_device(
    model: GridModel, ready: DevicePose, camera: Camera, settings: RenderSettings, window: Window, pixels: np.ndarray,
    passes: Passes = DEFAULT_PASSES,
) -> Samples:  # fmt: skip
    """As ``grid_view.sample_view``."""
    rows, columns, spans = _seen(model, ready, camera, window, pixels)
    places, parts = rows * camera.width + columns, [no_samples(passes, ready.parts_shown)]
    for chunk in _trace_all(model, ready, camera, settings, rows, columns, spans, passes.normal):
        found = chunk.traced.found
        ray = places[chunk.pixels][found.ray] * settings.supersampling**2 + chunk.sub
        alpha = -torch.expm1(-found.density * settings.step)
        arrays = (ray, found.depth.float(), alpha.float(), found.rgb.float(), found.thing.float())
        whole = [array.cpu().numpy() for array in arrays]
        chosen = densest(whole[0], whole[1], whole[2])
        seen = Samples(*(array[chosen] for array in whole))
        if found.normal is not None:
            seen = replace(seen, normal=ready.in_world(found.normal)[chosen])
        if passes.cryptomatte:
            own = torch.nn.functional.one_hot(ready.part_of(found.slot), ready.parts_shown)
            seen = replace(seen, parts=own.float().cpu().numpy()[chosen])
        parts.append(seen)
    return join(parts)

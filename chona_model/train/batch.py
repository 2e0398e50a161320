"""A step's rays traced through the model: by the processor's kernels, or in stages of tensors on any device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.grid_inputs import Surfaces, parts_of
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.grid_trace import PoseRays, trace_rays
from chona_model.kernels.cpu.sample import GivenRays
from chona_model.render.tracing import RayRows, TraceSettings, make_pose_table, trace


@dataclass(frozen=True)
class DrawnRays:
    """R rays of one pose: origins and directions [R, 3] in root space, near and far depths [R], float32; what they
    should show, rgb [R, 3] uint8 and part [R] (0 nothing, 1 the person, 2 an object)."""

    origins: np.ndarray
    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray
    rgb: np.ndarray
    part: np.ndarray

    def __len__(self) -> int:
        return len(self.near)

    def only(self, traced: np.ndarray) -> DrawnRays:
        """The same rays, of which those that are not ``traced`` [R] miss everything and cost nothing."""
        return replace(self, far=np.where(traced, self.far, self.near))


@dataclass(frozen=True)
class Batch:
    """Rays of several poses.

    Attributes:
        figures, rays: of each pose; grids: of each pose, as the way taken wants them: ``Starts`` for the kernels,
            ``PosedPart`` for the stages.
        jitter: [R] float32 over all rays; ray_pair: [R, N] int64 rows of ``pairs`` for every object slot.
        pairs: [Q, 2] identity pairs; codes: [P, C] pose codes; lights: [P, 9, 3].
    """

    figures: Sequence[PosedFigure]
    grids: Sequence[Any]
    rays: Sequence[DrawnRays]
    jitter: np.ndarray
    ray_pair: np.ndarray
    pairs: Tensor
    codes: Tensor
    lights: Tensor


def trace_fused(
    model: GridModel, batch: Batch, matrices: Sequence[Tensor], surfaces: Surfaces, settings: TraceSettings
) -> Tensor:
    """[R, 6] of the batch's rays, pose after pose (see ``grid_trace.trace_rays``)."""
    rows, begin = [], 0
    for place, (figure, rays) in enumerate(zip(batch.figures, batch.rays, strict=True)):
        own = slice(begin, begin + len(rays))
        given = GivenRays(
            rays.origins, rays.directions, rays.near, rays.far, batch.jitter[own], batch.ray_pair[own], place
        )
        light = batch.lights[place].detach().numpy()
        parts = parts_of(model, figure, model.occupancy, surfaces, light)
        rows.append(PoseRays(figure, matrices[place], batch.grids[place], parts, given))
        begin = own.stop
    return trace_rays(model, rows, batch.pairs, batch.codes, batch.lights, settings)[0]


def trace_staged(model: GridModel, batch: Batch, skinning: bool, surfaces: Surfaces, settings: TraceSettings) -> Tensor:
    """The same by ``render.tracing`` on the model's device; ``skinning``: whether it gets gradients."""
    with torch.set_grad_enabled(skinning):
        matrices, index = model.matrices(batch.figures)
    table = make_pose_table(model, batch.figures, model.occupancy, surfaces.normals, batch.grids)

    def joined(name: str) -> Tensor:
        return model.real(np.concatenate([getattr(rays, name) for rays in batch.rays]))

    places = np.repeat(np.arange(len(batch.rays), dtype=np.int32), [len(rays) for rays in batch.rays])
    rays = RayRows(
        joined("origins"), joined("directions"), joined("near"), joined("far"), model.real(batch.jitter),
        torch.as_tensor(places, device=model.device), torch.as_tensor(batch.ray_pair, device=model.device),
    )  # fmt: skip
    pairs = batch.pairs.to(model.device)
    return trace(model, table, matrices, index, rays, pairs, batch.codes, batch.lights, settings).out

"""A pose made ready to be looked at, and the view of a camera on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from chona_model.actor import Samples
from chona_model.camera import Camera
from chona_model.grid_inputs import Surfaces, limits_of, parts_of, starts_of, tables_of, volume_of
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels.cpu import advance, face, newton
from chona_model.kernels.cpu import perceptron as kernels
from chona_model.kernels.cpu import sample as tracing_kernels
from chona_model.kernels.cpu.sample import GivenRays
from chona_model.kernels.perceptron import pack
from chona_model.kernels.threads import in_pieces
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.render.occupancy import Occupancy, PartCells
from chona_model.render.posed import PosedPart, Window, depth_spans
from chona_model.samples import densest, join, no_samples, weights_along
from chona_model.settings import RenderSettings

cpu: Any = tracing_kernels
faces: Any = face

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

    @property
    def parts_shown(self) -> int:
        """How many parts the pose has."""
        return (self.figure.person >= 0) + len(self.figure.objects)


@dataclass(frozen=True)
class View:
    """What rays found.

    Attributes:
        rows, columns: [R] pixels that were looked at; values: [R, COLUMNS] means over their rays, but sums of the last
            two (see ``kernels.cpu.advance.COLUMNS``).
        evaluated: how often the field was evaluated.
        normal: [R, 3] as in ``Picture``; None where not asked for.
        parts: [R, P] as in ``Picture``; None where not asked for, or where ``values`` say it: with one object at most.
    """

    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    evaluated: int
    normal: np.ndarray | None = None
    parts: np.ndarray | None = None


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
        codes = model.field.codes(model.pairs(posed))
        pose_code = torch.as_tensor(posed.code[None], dtype=torch.float32) if settings.shading else None
        network = pack(model.field.weights(codes, pose_code))
        light = model.root_light([posed])[0].numpy()
    part = model.pose_cells(posed, cells, matrices, settings.starts)
    volume, parts = volume_of(model, posed, matrices), parts_of(model, posed, occupancy, surfaces, light)
    return ReadyPose(posed, part, volume, starts_of(part), parts, network)


@dataclass(frozen=True)
class _Aim:
    """Pixels that are looked at and what their rays are traced with.

    Attributes:
        places: [P, 2] int32 column and row; near, far: [P] depths; lens, drift: see ``aim``.
        side: rays a pixel along each axis; slots: rows of the identities' biases; rest: what else the kernel takes.
    """

    places: np.ndarray
    near: np.ndarray
    far: np.ndarray
    lens: np.ndarray
    drift: np.ndarray
    side: int
    slots: np.ndarray
    rest: tuple[Any, ...]

    def rays(self, begin: int, end: int) -> GivenRays:
        """Rays of the pixels ``begin`` to ``end``."""
        real, count = np.float32, (end - begin) * self.side**2
        origin, direction = np.empty((2, count, 3), real)
        near, far = np.empty((2, count), real)
        cpu.aim(begin, self.places, self.near, self.far, self.lens, self.drift, self.side, origin, direction, near, far)
        pair = np.broadcast_to(self.slots, (count, len(self.slots))).copy()
        return GivenRays(origin, direction, near, far, np.full(count, 0.5, real), pair, 0)


def _aim(
    model: GridModel, ready: ReadyPose, camera: Camera, settings: RenderSettings, window: Window,
    pixels: np.ndarray | None,
) -> _Aim:  # fmt: skip
    near, far = depth_spans(ready.part, ready.figure.figure, camera, window)
    seen = far > near
    if pixels is not None:
        seen &= pixels[window.top : window.bottom, window.left : window.right]
    where = np.nonzero(seen)
    places = np.stack([where[1] + window.left, where[0] + window.top], axis=-1).astype(np.int32)
    origins, directions = ready.figure.figure.rays(camera, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    lens = np.stack([origins[0], directions[0], directions[1] - directions[0], directions[2] - directions[0]])
    limits = limits_of(settings.step, settings.stop, settings.newton_steps, settings.tolerance, LONGEST, ACCEPT)
    return _Aim(
        places, near[where], far[where], lens.astype(np.float32), (origins[1:] - origins[0]).astype(np.float32),
        settings.supersampling, np.arange(1 + len(ready.parts.slot_part)),
        (ready.volume, ready.starts, ready.parts, tables_of(model), ready.network, limits),
    )  # fmt: skip


def render_view(
    model: GridModel, ready: ReadyPose, camera: Camera, settings: RenderSettings, window: Window,
    pixels: np.ndarray | None = None, passes: Passes = DEFAULT_PASSES,
) -> View:  # fmt: skip
    """Traces every pixel of a window that the pose's occupied cells may be seen in.

    Args:
        pixels: [H, W] bool of the whole image: only these. None: all.
        passes: normals, and the parts of a pose of several objects, take the samples themselves to be kept.
    """
    aim = _aim(model, ready, camera, settings, window, pixels)
    count, several = len(aim.places), passes.cryptomatte and len(ready.figure.objects) > 1
    keep = passes.normal or several
    out = np.empty((count, advance.COLUMNS), dtype=np.float32)
    normal = np.empty((count, 3), np.float32) if passes.normal else None
    parts = np.empty((count, ready.parts_shown), np.float32) if several else None

    def look(begin: int, end: int) -> int:
        rays = aim.rays(begin, end)
        values = np.empty((len(rays.near), advance.COLUMNS), np.float32)
        evaluated, found, _, _ = cpu.sample(0, len(rays.near), keep, rays, *aim.rest, values)
        of_pixels = values.reshape(end - begin, aim.side**2, -1)
        out[begin:end, :6], out[begin:end, 6:] = of_pixels[..., :6].mean(axis=1), of_pixels[..., 6:].sum(axis=1)
        if keep:
            seen = _samples(ready, found, settings, passes)
            weight = weights_along(seen.ray, seen.alpha, settings.stop) / aim.side**2
            for array, columns in ((normal, seen.normal), (parts, seen.parts)):
                if array is not None and columns is not None:
                    sums = [np.bincount(seen.ray // aim.side**2, weight * own, end - begin) for own in columns.T]
                    array[begin:end] = np.stack(sums, axis=-1)
        return evaluated

    evaluated = in_pieces(look, count, PIECE)
    return View(aim.places[:, 1], aim.places[:, 0], out, sum(evaluated), _in_world(ready, normal), parts)


def sample_view(
    model: GridModel, ready: ReadyPose, camera: Camera, settings: RenderSettings, window: Window, pixels: np.ndarray,
    passes: Passes = DEFAULT_PASSES,
) -> Samples:  # fmt: skip
    """The samples themselves of some pixels [H, W] bool, to be integrated with those of others."""
    aim = _aim(model, ready, camera, settings, window, pixels)

    def look(begin: int, end: int) -> Samples:
        rays = aim.rays(begin, end)
        values = np.empty((len(rays.near), advance.COLUMNS), np.float32)
        found = cpu.sample(0, len(rays.near), True, rays, *aim.rest, values)[1]
        seen = _samples(ready, found, settings, passes)
        columns, rows = aim.places[begin:end].astype(np.int64).T
        pixel, subs = rows * camera.width + columns, aim.side**2
        ray = pixel[seen.ray // subs] * subs + seen.ray % subs
        return replace(seen, ray=ray, normal=_in_world(ready, seen.normal))

    return join([no_samples(passes, ready.parts_shown), *in_pieces(look, len(aim.places), PIECE)])


def _in_world(ready: ReadyPose, normal: np.ndarray | None) -> np.ndarray | None:
    return None if normal is None else ready.figure.figure.turn_to_world(normal)


def _samples(ready: ReadyPose, found: advance.Candidates, settings: RenderSettings, passes: Passes) -> Samples:
    """What counts of what a piece's rays met; ``ray`` counts from the piece's first, normals are in root space."""
    chosen = densest(found.ray, found.depth, found.density)
    thing, normal, parts = found.thing[chosen].astype(np.float32), None, None
    if passes.normal:
        normal = np.empty((len(chosen), 3), np.float32)
        faces.face(chosen, found, ready.volume, ready.parts, normal)
    if passes.cryptomatte:
        place = np.where(found.thing[chosen], found.pair[chosen] - (ready.figure.person < 0), 0)
        parts = (place[:, None] == np.arange(ready.parts_shown)).astype(np.float32)
    alpha = -np.expm1(-found.density[chosen] * np.float32(settings.step))
    return Samples(found.ray[chosen], found.depth[chosen], alpha, found.rgb[chosen], thing, normal, parts)

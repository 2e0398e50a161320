"""Training rays through a grid model in one pass each way: what ``render.tracing`` does in stages, fused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.grid_inputs import limits_of, parts_of, starts_of, tables_of, volume_of
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels import perceptron
from chona_model.kernels.cpu import advance, encode, newton, skinning
from chona_model.kernels.cpu import perceptron as network_kernels
from chona_model.kernels.cpu import sample as kernels
from chona_model.kernels.threads import in_pieces
from chona_model.kernels.warp import MIN_DETERMINANT, VolumeIndex
from chona_model.render.posed import PosedPart
from chona_model.render.tracing import TraceSettings

cpu: Any = kernels
PIECE = 256
"""Rays a thread takes at once."""


@dataclass(frozen=True)
class PoseRays:
    """Rays of one pose; float32 arrays as in ``kernels.cpu.sample.GivenRays``.

    Attributes:
        posed, part: the pose and its start grid.
        pair: [R, N] int64 rows of the identity pairs in use, a column a slot.
    """

    posed: PosedFigure
    part: PosedPart
    origins: np.ndarray
    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray
    jitter: np.ndarray
    pair: np.ndarray


@dataclass
class _Piece:
    """Some rays of one pose and what the way forward kept of them."""

    pose: int
    begin: int
    end: int
    found: Any = None
    first: Any = None
    order: Any = None
    grad_points: Any = None


def trace_rays(
    model: GridModel, rays: Sequence[PoseRays], matrices: Tensor, index: VolumeIndex, pairs: Tensor,
    codes: Tensor | None, settings: TraceSettings,
) -> tuple[Tensor, int]:  # fmt: skip
    """Traces rays, differentiable in the field and in the matrices; the tables' gradient goes to the field's buffer.

    Args:
        rays: of each pose, in the order of ``matrices``; matrices, index: from ``GridModel.matrices`` of the poses.
        pairs: [Q, 2] identity pairs; codes: [P, C] pose codes, or None for no shading.

    Returns:
        [R, 6] as ``kernels.volume.integrate``'s, of all poses' rays one after the other; and how often the field was
        evaluated.
    """
    weights = model.field.weights(model.field.codes(pairs), codes)
    work = _Work(model, rays, index, settings)
    out = _Trace.apply(work, matrices, *weights.tensors())
    return out, work.evaluated


class _Work:
    """What both ways of one pass share, besides tensors."""

    def __init__(self, model: GridModel, rays: Sequence[PoseRays], index: VolumeIndex, settings: TraceSettings) -> None:
        self.model, self.rays, self.index, self.settings = model, rays, index, settings
        self.tables = tables_of(model)
        root = settings.newton
        self.limits = limits_of(
            settings.step, settings.stop, root.steps, root.tolerance, root.max_step, settings.accept
        )
        self.pieces = [
            _Piece(pose, begin, min(begin + PIECE, len(each.near)))
            for pose, each in enumerate(rays)
            for begin in range(0, len(each.near), PIECE)
        ]
        self.evaluated = 0

    def volume(self, pose: int, matrices: np.ndarray) -> newton.Volume:
        posed, row = self.rays[pose].posed, self.index.first_row[pose]
        count = len(self.model.grid(posed.person).points) if posed.person >= 0 else 0
        return volume_of(self.model, posed, matrices[row : row + count])

    def in_threads(self, work: Any, count: int) -> None:
        in_pieces(lambda begin, _: work(begin), count, 1)


class _Trace(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, work: _Work, matrices: Tensor, *weights: Tensor | None) -> Tensor:
        network = perceptron.pack(perceptron.FieldWeights(*weights))  # type: ignore[arg-type]
        model, rows = work.model, matrices.detach().numpy()
        out = [np.empty((len(each.near), advance.COLUMNS), dtype=np.float32) for each in work.rays]
        volumes = [work.volume(pose, rows) for pose in range(len(work.rays))]
        starts = [starts_of(each.part) for each in work.rays]
        parts = [parts_of(model, each.posed) for each in work.rays]

        def run(number: int) -> None:
            piece = work.pieces[number]
            each, pose = work.rays[piece.pose], piece.pose
            given = kernels.GivenRays(
                each.origins, each.directions, each.near, each.far, each.jitter, each.pair,
                min(pose, max(len(network.shade_bias) - 1, 0)),
            )  # fmt: skip
            piece.found, piece.first, piece.order = cpu.sample(
                piece.begin, piece.end, given, volumes[pose], starts[pose], parts[pose], work.tables, network,
                work.limits, out[pose],
            )  # fmt: skip

        work.in_threads(run, len(work.pieces))
        work.evaluated = sum(len(piece.order) for piece in work.pieces)
        ctx.work, ctx.network = work, network
        ctx.save_for_backward(matrices, *weights)
        return torch.from_numpy(np.concatenate(out)[:, :6])

    @staticmethod
    def backward(ctx: Any, grad_out: Tensor) -> tuple[Any, ...]:
        work, network = ctx.work, ctx.network
        matrices, *weights = ctx.saved_tensors
        grads = np.split(grad_out.contiguous().numpy(), np.cumsum([len(each.near) for each in work.rays])[:-1])
        transposed, skins = perceptron.transpose(network), ctx.needs_input_grad[1]
        sums = [network_kernels.Network(*(np.zeros_like(array) for array in network)) for _ in work.pieces]
        encoded: list[Any] = [None] * len(work.pieces)

        def run(number: int) -> None:
            piece = work.pieces[number]
            found, count = piece.found, len(piece.order)
            grad_density, grad_rgb = np.empty(count, np.float32), np.empty((count, 3), np.float32)
            cpu.sample_backward(
                piece.first, piece.order, found, work.limits.step, work.limits.stop,
                grads[piece.pose][piece.begin : piece.end], grad_density, grad_rgb,
            )  # fmt: skip
            grad_x = np.empty((count, network.both.shape[0]), np.float32)
            perceptron.cpu.backward(
                network, transposed, found.x, 0, count, found.pair, found.pose, work.tables.scale, grad_density,
                grad_rgb, grad_x, sums[number],
            )  # fmt: skip
            encoded[number] = grad_x
            if skins:
                piece.grad_points = np.empty((count, 3), np.float32)
                encode.encode_backward_points(
                    0, count, found.point, found.part, work.tables.lower, work.tables.table, grad_x,
                    *work.model.field.layout.arguments(), piece.grad_points,
                )  # fmt: skip

        work.in_threads(run, len(work.pieces))
        buffer = work.model.field.gradient.buffer.numpy()

        def scatter(level: int) -> None:
            for piece, grad_x in zip(work.pieces, encoded, strict=True):
                encode.encode_backward_table(
                    level, piece.found.point, piece.found.part, work.tables.lower, grad_x,
                    *work.model.field.layout.arguments(), buffer,
                )  # fmt: skip

        work.in_threads(scatter, work.model.field.layout.levels)
        grad_matrices = _grad_matrices(work, matrices) if skins else None
        total = network_kernels.Network(*(np.sum(arrays, axis=0) for arrays in zip(*sums, strict=True)))
        return None, grad_matrices, *perceptron.unpack(total, perceptron.FieldWeights(*weights))


def _grad_matrices(work: _Work, matrices: Tensor) -> Tensor:
    """Through the roots of samples on persons, by the implicit function theorem; a thread a pose."""
    grad, index = torch.zeros_like(matrices), work.index

    def run(pose: int) -> None:
        for piece in work.pieces:
            if piece.pose != pose:
                continue
            body = np.flatnonzero(~piece.found.thing)
            skinning.invert_backward(
                piece.found.point[body], piece.grad_points[body], np.full(len(body), pose, np.int32),
                matrices.detach().numpy(), index.nodes, index.first_node, index.dims, index.first_row, index.origins,
                np.float32(index.inverse_cell), np.float32(MIN_DETERMINANT), grad.numpy(),
            )  # fmt: skip

    work.in_threads(run, len(work.rays))
    return grad

"""Training rays through a grid model in one pass each way: what ``render.tracing`` does in stages, fused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.grid_inputs import limits_of, tables_of, volume_of
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels import perceptron
from chona_model.kernels.cpu import advance, encode, skinning
from chona_model.kernels.cpu import perceptron as network_kernels
from chona_model.kernels.cpu import sample as kernels
from chona_model.kernels.cpu.light import TERMS
from chona_model.kernels.reference.light import terms
from chona_model.kernels.threads import in_pieces
from chona_model.kernels.warp import MIN_DETERMINANT
from chona_model.render.tracing import TraceSettings

cpu: Any = kernels
PIECE = 256
"""Rays a thread takes at once."""


@dataclass(frozen=True)
class PoseRays:
    """Rays of one pose.

    Attributes:
        posed: the pose; matrices: [M, 16] its blended matrices; starts, parts: see ``grid_inputs``.
        given: the rays; their ``pose`` is the pose's place in the batch.
    """

    posed: PosedFigure
    matrices: Tensor
    starts: advance.Starts
    parts: advance.Parts
    given: kernels.GivenRays


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
    model: GridModel, rays: Sequence[PoseRays], pairs: Tensor, codes: Tensor | None, lights: Tensor,
    settings: TraceSettings,
) -> tuple[Tensor, int]:  # fmt: skip
    """Traces rays, differentiable in the field and in the matrices; the tables' gradient goes to the field's buffer.

    Args:
        pairs: [Q, 2] identity pairs; codes: [P, C] pose codes, or None for no shading.
        lights: [P, 9, 3] of the poses, equal to those in their ``parts``; here for its gradient.

    Returns:
        [R, 6] as ``kernels.volume.integrate``'s, of all poses' rays one after the other; and how often the field was
        evaluated.
    """
    weights = model.field.weights(model.field.codes(pairs), codes)
    work = _Work(model, rays, settings)
    out = _Trace.apply(work, *(each.matrices for each in rays), lights, *weights.tensors())
    return out, work.evaluated


class _Work:
    """What both ways of one pass share, besides tensors."""

    def __init__(self, model: GridModel, rays: Sequence[PoseRays], settings: TraceSettings) -> None:
        self.model, self.rays = model, rays
        self.tables = tables_of(model)
        root = settings.newton
        self.limits = limits_of(
            settings.step, settings.stop, root.steps, root.tolerance, root.max_step, settings.accept
        )
        self.pieces = [
            _Piece(pose, begin, min(begin + PIECE, len(each.given.near)))
            for pose, each in enumerate(rays)
            for begin in range(0, len(each.given.near), PIECE)
        ]
        self.evaluated = 0

    def in_threads(self, work: Any, count: int) -> None:
        in_pieces(lambda begin, _: work(begin), count, 1)


class _Trace(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, work: _Work, *tensors: Tensor | None) -> Tensor:
        weights: Any = tensors[len(work.rays) + 1 :]
        network = perceptron.pack(perceptron.FieldWeights(*weights))
        out = [np.empty((len(each.given.near), advance.COLUMNS), dtype=np.float32) for each in work.rays]
        volumes = [volume_of(work.model, each.posed, each.matrices.detach().numpy()) for each in work.rays]

        def run(number: int) -> None:
            piece = work.pieces[number]
            each, pose = work.rays[piece.pose], piece.pose
            _, piece.found, piece.first, piece.order = cpu.sample(
                piece.begin, piece.end, True, each.given, volumes[pose], each.starts, each.parts, work.tables, network,
                work.limits, out[pose],
            )  # fmt: skip

        work.in_threads(run, len(work.pieces))
        work.evaluated = sum(len(piece.order) for piece in work.pieces)
        ctx.work, ctx.network = work, network
        ctx.save_for_backward(*weights)
        return torch.from_numpy(np.concatenate(out)[:, :6])

    @staticmethod
    def backward(ctx: Any, grad_out: Tensor) -> tuple[Any, ...]:
        work, network = ctx.work, ctx.network
        weights: Any = ctx.saved_tensors
        grads = np.split(grad_out.contiguous().numpy(), np.cumsum([len(each.given.near) for each in work.rays])[:-1])
        transposed = perceptron.transpose(network)
        skins = [bool(needed) for needed in ctx.needs_input_grad[1 : 1 + len(work.rays)]]
        sums = [network_kernels.Network(*(np.zeros_like(array) for array in network)) for _ in work.pieces]
        encoded: list[Any] = [None] * len(work.pieces)
        lights: list[Any] = [None] * len(work.pieces)

        def run(number: int) -> None:
            piece = work.pieces[number]
            found, count = piece.found, len(piece.order)
            grad_density, grad_rgb = np.empty(count, np.float32), np.empty((count, 3), np.float32)
            cpu.sample_backward(
                piece.first, piece.order, found, work.limits.step, work.limits.stop,
                grads[piece.pose][piece.begin : piece.end], grad_density, grad_rgb,
            )  # fmt: skip
            lights[number] = terms(torch.from_numpy(found.normal)).T @ torch.from_numpy(grad_rgb * found.rgb)
            grad_rgb *= found.gain
            grad_x = np.empty((count, network.both.shape[0]), np.float32)
            perceptron.cpu.backward(
                network, transposed, found.x, 0, count, found.pair, found.pose, work.tables.scale, grad_density,
                grad_rgb, grad_x, sums[number],
            )  # fmt: skip
            encoded[number] = grad_x
            if skins[piece.pose]:
                piece.grad_points = np.empty((count, 3), np.float32)
                encode.encode_backward_points(
                    0, count, found.point, work.tables.of[found.part], work.tables.lower, work.tables.table, grad_x,
                    *work.model.field.layout.arguments(), piece.grad_points,
                )  # fmt: skip

        work.in_threads(run, len(work.pieces))
        gradient = work.model.field.gradient
        buffer = gradient.buffer.numpy()

        def scatter(level: int) -> None:
            for piece, grad_x in zip(work.pieces, encoded, strict=True):
                encode.encode_backward_table(
                    level, piece.found.point, work.tables.of[piece.found.part], work.tables.lower, grad_x,
                    *work.model.field.layout.arguments(), buffer, gradient.touched,
                )  # fmt: skip

        work.in_threads(scatter, work.model.field.layout.levels)
        grad_matrices: list[Any] = [None] * len(work.rays)

        def through_roots(pose: int) -> None:
            if skins[pose]:
                grad_matrices[pose] = _grad_matrices(work, pose)

        work.in_threads(through_roots, len(work.rays))
        total = network_kernels.Network(*(np.sum(arrays, axis=0) for arrays in zip(*sums, strict=True)))
        grad_lights = torch.zeros(len(work.rays), TERMS, 3)
        for piece, light in zip(work.pieces, lights, strict=True):
            grad_lights[piece.pose] += light
        return None, *grad_matrices, grad_lights, *perceptron.unpack(total, perceptron.FieldWeights(*weights))


def _grad_matrices(work: _Work, pose: int) -> Tensor:
    """Through the roots of samples on the person, by the implicit function theorem."""
    each = work.rays[pose]
    grad, grid = torch.zeros_like(each.matrices), work.model.grid(each.posed.person)
    begin, dims, origin = np.zeros(1, np.int64), grid.dims[None], grid.origin[None].astype(np.float32)
    for piece in work.pieces:
        if piece.pose == pose:
            body = np.flatnonzero(~piece.found.thing)
            skinning.invert_backward(
                piece.found.point[body], piece.grad_points[body], np.zeros(len(body), np.int32),
                each.matrices.detach().numpy(), grid.nodes, begin, dims, begin, origin, np.float32(1 / grid.cell),
                np.float32(MIN_DETERMINANT), grad.numpy(),
            )  # fmt: skip
    return grad

"""The seam for the grid field's perceptrons: numba on the CPU, plain torch for other devices, dtypes and sizes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from chona_model.kernels.cpu import perceptron as kernels
from chona_model.kernels.cpu.simd import LANES
from chona_model.kernels.grid import fast
from chona_model.kernels.reference.perceptron import SHADE_BIAS, perceptron
from chona_model.kernels.threads import in_pieces

cpu: Any = kernels
CHUNK = 2048
"""Rows whose gradients are summed before they meet others'."""


@dataclass(frozen=True)
class FieldWeights:
    """Weights of the perceptrons; biases that depend on codes or pose have a row for every pair or pose.

    Attributes:
        density_in [H, E], density_bias [Q, H], density_out [1 + F, H], density_out_bias [1 + F]: density and features.
        colour_in [H, E + F], colour_bias [Q, H], colour_out [3, H], colour_out_bias [3]: albedo.
        shade_in [S, F], shade_bias [P, S], shade_out [1, S], shade_out_bias [1]: ambient occlusion; ``shade_bias``
            None leaves it out.
    """

    density_in: Tensor
    density_bias: Tensor
    density_out: Tensor
    density_out_bias: Tensor
    colour_in: Tensor
    colour_bias: Tensor
    colour_out: Tensor
    colour_out_bias: Tensor
    shade_in: Tensor
    shade_bias: Tensor | None
    shade_out: Tensor
    shade_out_bias: Tensor

    def tensors(self) -> list[Tensor | None]:
        """All of them, in order."""
        return [getattr(self, item.name) for item in fields(self)]


def fits(weights: FieldWeights) -> bool:
    """Whether the kernel takes these sizes: whole vectors of inputs and hidden units, features within one vector."""
    hidden, inputs = weights.density_in.shape
    return hidden % LANES == 0 and inputs % LANES == 0 and len(weights.density_out) <= LANES


def pack(weights: FieldWeights) -> kernels.Network:
    """Weights as the kernel wants them: input rows, padded to whole vectors."""
    w = weights
    inputs = w.density_in.shape[1]
    features = w.shade_in.shape[1]
    spare = LANES - 1 - features  # columns of ``raw`` that nothing uses
    shades = -(-len(w.shade_in) // LANES) * LANES - len(w.shade_in)
    shade_bias = w.shade_bias if w.shade_bias is not None else w.shade_in.new_zeros(0, len(w.shade_in))
    packed = (
        torch.cat([w.density_in, w.colour_in[:, :inputs]]).T,
        torch.cat([w.density_bias, w.colour_bias], dim=1),
        pad(w.density_out.T, (0, spare)),
        pad(w.density_out_bias, (0, spare)),
        pad(w.colour_in[:, inputs:].T, (0, 0, 1, spare)),
        pad(w.colour_out.T, (0, LANES - 3)),
        pad(w.colour_out_bias, (0, LANES - 3)),
        pad(w.shade_in.T, (0, shades, 1, spare)),
        pad(shade_bias, (0, shades)),
        pad(w.shade_out.T, (0, LANES - 1, 0, shades)),
        pad(w.shade_out_bias + SHADE_BIAS, (0, LANES - 1)),
    )
    return kernels.Network(*(part.detach().contiguous().numpy() for part in packed))


def unpack(sums: kernels.Network, weights: FieldWeights) -> list[Tensor | None]:
    """Gradients of the packed weights, in the order of ``FieldWeights``."""
    grads: Any = kernels.Network(*(torch.from_numpy(array) for array in sums))  # type: ignore[arg-type]
    w = weights
    hidden = len(w.density_in)
    features, shades = w.shade_in.shape[1], len(w.shade_in)
    used = slice(1, 1 + features)
    density_in, colour_in = grads.both[:, :hidden].T, grads.both[:, hidden:].T
    return [
        density_in, grads.both_bias[:, :hidden], grads.raw[:, : 1 + features].T, grads.raw_bias[: 1 + features],
        torch.cat([colour_in, grads.features[used].T], dim=1), grads.both_bias[:, hidden:],
        grads.colour[:, :3].T, grads.colour_bias[:3], grads.shade_in[used, :shades].T,
        None if w.shade_bias is None else grads.shade_bias[:, :shades], grads.shade_out[:shades, :1].T,
        grads.shade_out_bias[:1],
    ]  # fmt: skip


def transpose(network: kernels.Network) -> kernels.Transposed:
    """What the backward pass multiplies with."""
    n = network
    arrays = (n.both, n.raw, n.features, n.colour, n.shade_in, n.shade_out)
    return kernels.Transposed(*(np.ascontiguousarray(array.T) for array in arrays))


class _Perceptron(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, encoded: Tensor, pair: Tensor, pose: Tensor, scale: float, *weights: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        density, rgb = encoded.new_empty(len(encoded)), encoded.new_empty(len(encoded), 3)
        network = pack(FieldWeights(*weights))  # type: ignore[arg-type]
        arrays = (pair.numpy(), pose.numpy(), np.float32(scale), density.numpy(), rgb.numpy())
        x = encoded.detach().numpy()
        in_pieces(lambda begin, end: cpu.forward(network, x, begin, end, *arrays), len(x), CHUNK)
        ctx.save_for_backward(encoded, pair, pose, *weights)
        ctx.scale, ctx.network = np.float32(scale), network
        return density, rgb

    @staticmethod
    def backward(ctx: Any, grad_density: Tensor, grad_rgb: Tensor) -> tuple[Tensor | None, ...]:
        encoded, pair, pose, *weights = ctx.saved_tensors
        network: kernels.Network = ctx.network
        transposed = transpose(network)
        grad_encoded = torch.empty_like(encoded)
        arrays = (
            pair.numpy(), pose.numpy(), ctx.scale, grad_density.contiguous().numpy(), grad_rgb.contiguous().numpy(),
            grad_encoded.numpy(),
        )  # fmt: skip
        x = encoded.detach().numpy()

        def add(begin: int, end: int) -> kernels.Network:
            sums = kernels.Network(*(np.zeros_like(array) for array in network))
            cpu.backward(network, transposed, x, begin, end, *arrays, sums)
            return sums

        # Whatever the number of threads, the same chunks are summed in the same order.
        parts = in_pieces(add, len(x), CHUNK) or [kernels.Network(*(np.zeros_like(array) for array in network))]
        total = kernels.Network(*(np.sum(arrays, axis=0) for arrays in zip(*parts, strict=True)))
        return grad_encoded, None, None, None, *unpack(total, FieldWeights(*weights))


def evaluate(
    encoded: Tensor, weights: FieldWeights, pair: Tensor, pose: Tensor, density_scale: float
) -> tuple[Tensor, Tensor]:
    """Density [M] and rgb [M, 3] of encoded points [M, E] (see ``reference.perceptron``)."""
    if not fast(encoded) or not fits(weights):
        return perceptron(encoded, weights, pair, pose, density_scale)
    density, rgb = _Perceptron.apply(encoded.contiguous(), pair, pose, density_scale, *weights.tensors())
    return density, rgb

"""The seam for the grid field's perceptrons: cache-sized chunks, recomputed in the backward pass.

Between narrow matrix products the time goes into moving activations.  A chunk's activations stay in a core's L2, and
computing them again in the backward pass is cheaper than writing them out.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import softplus

from chona_model.kernels.reference.perceptron import SHADE_BIAS, perceptron

CHUNK = 8192
"""Rows computed at once: 8192 · 64 activations of four bytes are 2 MB."""


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


class _Chunk:
    """Activations of one chunk."""

    def __init__(self, encoded: Tensor, packed: _Packed, pair: Tensor | None, pose: Tensor | None) -> None:
        hidden = packed.hidden
        self.x = encoded
        both = torch.mm(self.x, packed.into_both.T)
        bias = packed.both_bias if pair is None else packed.both_bias[pair]
        both += bias
        self.h = both[:, :hidden].relu_()
        self.raw = torch.addmm(packed.density_out_bias, self.h, packed.density_out.T)
        self.g = both[:, hidden:].addmm_(self.raw, packed.features_into_colour.T).relu_()
        self.colour = torch.addmm(packed.colour_out_bias, self.g, packed.colour_out.T).sigmoid_()
        self.both = both
        self.s = self.shade = None
        if packed.shade_bias is not None:
            bias = packed.shade_bias if pose is None else packed.shade_bias[pose]
            self.s = torch.mm(self.raw, packed.features_into_shade.T).add_(bias).relu_()
            shade = torch.mm(self.s, packed.shade_out.T)
            self.shade = shade.add_(packed.shade_out_bias + SHADE_BIAS).sigmoid_()


class _Packed:
    """Weights with the first layers of density and colour side by side."""

    def __init__(self, weights: list[Tensor | None]) -> None:
        w = FieldWeights(*weights)  # type: ignore[arg-type]
        encoded = w.density_in.shape[1]
        self.hidden = w.density_in.shape[0]
        self.into_both = torch.cat([w.density_in, w.colour_in[:, :encoded]])
        self.both_bias = torch.cat([w.density_bias, w.colour_bias], dim=1)
        self.density_out, self.density_out_bias = w.density_out, w.density_out_bias
        # A zero column for the density, so that ``raw`` feeds the next layers as it is.
        self.features_into_colour = torch.nn.functional.pad(w.colour_in[:, encoded:], (1, 0))
        self.colour_out, self.colour_out_bias = w.colour_out, w.colour_out_bias
        self.features_into_shade = torch.nn.functional.pad(w.shade_in, (1, 0))
        self.shade_bias = w.shade_bias
        self.shade_out, self.shade_out_bias = w.shade_out, w.shade_out_bias


class _Perceptron(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, encoded: Tensor, pair: Tensor, pose: Tensor, scale: float, *weights: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        packed = _Packed(list(weights))
        density, rgb = encoded.new_empty(len(encoded)), encoded.new_empty(len(encoded), 3)
        for part, pairs, poses in _chunks(packed, pair, pose):
            chunk = _Chunk(encoded[part], packed, pairs, poses)
            density[part] = softplus(chunk.raw[:, 0] - 1.0) * scale
            rgb[part] = chunk.colour if chunk.shade is None else chunk.colour * chunk.shade
        ctx.save_for_backward(encoded, pair, pose, *weights)
        ctx.scale = scale
        return density, rgb

    @staticmethod
    def backward(ctx: Any, grad_density: Tensor, grad_rgb: Tensor) -> tuple[Tensor | None, ...]:
        encoded, pair, pose, *weights = ctx.saved_tensors
        packed = _Packed(weights)
        grads = _Gradients(weights, packed)
        grad_encoded = torch.empty_like(encoded)
        for part, pairs, poses in _chunks(packed, pair, pose):
            chunk = _Chunk(encoded[part], packed, pairs, poses)
            grad_encoded[part] = grads.add(chunk, packed, grad_density[part] * ctx.scale, grad_rgb[part], pairs, poses)
        return (grad_encoded, None, None, None, *grads.unpacked(packed))


class _Gradients:
    """Sums of the weights' gradients over chunks."""

    def __init__(self, weights: list[Tensor | None], packed: _Packed) -> None:
        self.into_both = torch.zeros_like(packed.into_both)
        self.both_bias = torch.zeros_like(packed.both_bias)
        self.features_into_colour = torch.zeros_like(packed.features_into_colour)
        self.features_into_shade = torch.zeros_like(packed.features_into_shade)
        self.own = [None if w is None else torch.zeros_like(w) for w in weights]

    def add(
        self,
        chunk: _Chunk,
        packed: _Packed,
        grad_density: Tensor,
        grad_rgb: Tensor,
        pair: Tensor | None,
        pose: Tensor | None,
    ) -> Tensor:
        """Adds one chunk; returns the gradient of its encoded points."""
        own, hidden = FieldWeights(*self.own), packed.hidden  # type: ignore[arg-type]
        grad_raw = None
        if chunk.shade is not None and chunk.s is not None and own.shade_bias is not None:
            grad_shade = (grad_rgb * chunk.colour).sum(1, keepdim=True) * chunk.shade * (1.0 - chunk.shade)
            own.shade_out_bias.add_(grad_shade.sum(0))
            own.shade_out.add_(torch.mm(grad_shade.T, chunk.s))
            grad_s = torch.mm(grad_shade, packed.shade_out).mul_(chunk.s > 0)
            self.features_into_shade.add_(torch.mm(grad_s.T, chunk.raw))
            _add_rows(own.shade_bias, grad_s, pose)
            grad_raw = torch.mm(grad_s, packed.features_into_shade)
            grad_rgb = grad_rgb * chunk.shade
        grad_colour = grad_rgb * chunk.colour * (1.0 - chunk.colour)
        own.colour_out_bias.add_(grad_colour.sum(0))
        own.colour_out.add_(torch.mm(grad_colour.T, chunk.g))
        grad_both = torch.empty_like(chunk.both)
        torch.mul(torch.mm(grad_colour, packed.colour_out), chunk.g > 0, out=grad_both[:, hidden:])
        grad_g = grad_both[:, hidden:]
        self.features_into_colour.add_(torch.mm(grad_g.T, chunk.raw))
        through = torch.mm(grad_g, packed.features_into_colour)
        grad_raw = through if grad_raw is None else grad_raw.add_(through)
        grad_raw[:, 0] = grad_density * torch.sigmoid(chunk.raw[:, 0] - 1.0)
        own.density_out.add_(torch.mm(grad_raw.T, chunk.h))
        own.density_out_bias.add_(grad_raw.sum(0))
        torch.mul(torch.mm(grad_raw, packed.density_out), chunk.h > 0, out=grad_both[:, :hidden])
        self.into_both.add_(torch.mm(grad_both.T, chunk.x))
        _add_rows(self.both_bias, grad_both, pair)
        return torch.mm(grad_both, packed.into_both)

    def unpacked(self, packed: _Packed) -> list[Tensor | None]:
        """In the order of ``FieldWeights``."""
        own, hidden = FieldWeights(*self.own), packed.hidden  # type: ignore[arg-type]
        own.density_in.copy_(self.into_both[:hidden])
        own.density_bias.copy_(self.both_bias[:, :hidden])
        own.colour_in.copy_(torch.cat([self.into_both[hidden:], self.features_into_colour[:, 1:]], dim=1))
        own.colour_bias.copy_(self.both_bias[:, hidden:])
        own.shade_in.copy_(self.features_into_shade[:, 1:])
        return self.own


def _chunks(packed: _Packed, pair: Tensor, pose: Tensor) -> Any:
    """Slices with their rows of pairs and poses; None where there is but one row."""
    one_pair = len(packed.both_bias) == 1
    one_pose = packed.shade_bias is None or len(packed.shade_bias) == 1
    for begin in range(0, len(pair), CHUNK):
        part = slice(begin, begin + CHUNK)
        yield part, None if one_pair else pair[part], None if one_pose else pose[part]


def _add_rows(total: Tensor, grad: Tensor, index: Tensor | None) -> None:
    """Adds gradients of rows that a bias was given to; by a product with one-hot rows, whose order is fixed."""
    if index is None:
        total[0].add_(grad.sum(0))
        return
    one_hot = torch.zeros(len(grad), len(total), dtype=grad.dtype, device=grad.device)
    one_hot[torch.arange(len(grad), device=grad.device), index] = 1
    total.add_(torch.mm(one_hot.T, grad))


def evaluate(
    encoded: Tensor, weights: FieldWeights, pair: Tensor, pose: Tensor, density_scale: float
) -> tuple[Tensor, Tensor]:
    """Density [M] and rgb [M, 3] of encoded points [M, E] (see ``reference.perceptron``)."""
    if encoded.dtype != torch.float32:
        return perceptron(encoded, weights, pair, pose, density_scale)
    density, rgb = _Perceptron.apply(encoded, pair, pose, density_scale, *weights.tensors())
    return density, rgb

"""The chunked perceptrons against plain torch: values and every gradient."""

from __future__ import annotations

import pytest
import torch

from chona_model.kernels.perceptron import CHUNK, FieldWeights, evaluate
from chona_model.kernels.reference.perceptron import perceptron


def make_weights(pairs: int, poses: int, shaded: bool, generator: torch.Generator) -> FieldWeights:
    def draw(*shape: int) -> torch.Tensor:
        return (torch.randn(*shape, generator=generator) * 0.3).requires_grad_()

    return FieldWeights(
        draw(64, 32), draw(pairs, 64), draw(16, 64), draw(16), draw(64, 47), draw(pairs, 64), draw(3, 64), draw(3),
        draw(24, 15), draw(poses, 24) if shaded else None, draw(1, 24), draw(1),
    )  # fmt: skip


def outcome(function, points: int, pairs: int, poses: int, shaded: bool):
    generator = torch.Generator().manual_seed(3)
    weights = make_weights(pairs, poses, shaded, generator)
    encoded = torch.randn(points, 32, generator=generator, requires_grad=True)
    pair = torch.randint(pairs, (points,), generator=generator)
    pose = torch.randint(poses, (points,), generator=generator)
    density, rgb = function(encoded, weights, pair, pose, 100.0)
    by = torch.randn(points, 4, generator=generator)
    ((density * by[:, 0]).sum() * 0.01 + (rgb * by[:, 1:]).sum()).backward()
    used = [w for w in weights.tensors() if w is not None and (shaded or w.shape[0] not in {24, 1})]
    return density, rgb, [encoded.grad, *(w.grad for w in used)]


@pytest.mark.parametrize("shaded", [False, True])
@pytest.mark.parametrize(("pairs", "poses"), [(1, 1), (3, 4)])
@pytest.mark.parametrize("points", [0, 7, CHUNK + 5])
def test_chunks_equal_plain_torch(points: int, pairs: int, poses: int, shaded: bool) -> None:
    density, rgb, grads = outcome(evaluate, points, pairs, poses, shaded)
    expected_density, expected_rgb, expected = outcome(perceptron, points, pairs, poses, shaded)
    torch.testing.assert_close(density, expected_density, rtol=1e-5, atol=1e-4)
    torch.testing.assert_close(rgb, expected_rgb, rtol=1e-5, atol=1e-6)
    for ours, theirs in zip(grads, expected, strict=True):
        if theirs is not None:
            torch.testing.assert_close(ours, theirs, rtol=2e-4, atol=2e-4)

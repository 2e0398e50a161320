"""Adam on touched rows: fast kernel, torch twin and torch's own Adam."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from chona_model.kernels import reference
from chona_model.kernels.cpu import adam as cpu

RATE, BETA1, BETA2, EPSILON = 0.01, 0.9, 0.99, 1e-15


def state(seed: int, rows: int = 300) -> list[Tensor]:
    """Table, gradient with half of its rows zero, and fresh moments."""
    generator = torch.Generator().manual_seed(seed)
    table, grad = (torch.randn(rows, 4, generator=generator) for _ in range(2))
    grad[torch.rand(rows, generator=generator) < 0.5] = 0.0
    grad[:20, 1:] = 0.0  # a row counts as touched by one of its features
    return [table, grad, torch.zeros(rows, 4), torch.zeros(rows, 4)]


def fast_step(tensors: list[Tensor], step: int) -> None:
    """One step of the kernel."""
    factors = RATE, BETA1, BETA2, EPSILON, 1 - BETA1**step, 1 - BETA2**step
    touched = tensors[1].numpy().any(axis=1).astype(np.uint8)
    half = len(touched) // 2
    for begin, end in ((0, half), (half, len(touched))):
        cpu.adam_rows(begin, end, *(t.numpy() for t in tensors), touched, *(np.float32(f) for f in factors))
    assert not touched.any()


def slow_step(tensors: list[Tensor], step: int) -> None:
    """One step of the twin."""
    reference.adam_rows(*tensors, RATE, BETA1, BETA2, EPSILON, 1 - BETA1**step, 1 - BETA2**step)


@pytest.mark.parametrize("seed", range(3))
def test_steps_equal_the_twin(seed: int) -> None:
    fast, slow = state(seed), state(seed)
    for step in range(1, 4):
        fresh = state(seed + 10 * step)[1]
        for tensors, take in ((fast, fast_step), (slow, slow_step)):
            tensors[1].copy_(fresh)
            take(tensors, step)
            assert not tensors[1].any()
    for a, b in zip(fast, slow, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6)


def test_touched_rows_equal_torch() -> None:
    tensors = state(0)
    table, grad = tensors[0].clone().requires_grad_(), tensors[1].clone()
    table.grad = grad
    torch.optim.Adam([table], lr=RATE, betas=(BETA1, BETA2), eps=EPSILON).step()
    fast_step(tensors, 1)
    torch.testing.assert_close(tensors[0], table.detach(), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("take", [fast_step, slow_step])
def test_untouched_rows_stay(take: object) -> None:
    tensors = state(1)
    tensors[2].fill_(0.5)
    tensors[3].fill_(0.25)
    before = [t.clone() for t in tensors]
    take(tensors, 5)  # type: ignore[operator]
    untouched = ~before[1].any(dim=1)
    assert untouched.any()
    for index in (0, 2, 3):
        assert torch.equal(tensors[index][untouched], before[index][untouched])
        assert not torch.equal(tensors[index][~untouched], before[index][~untouched])


def test_repeats_are_identical() -> None:
    first, second = state(3), state(3)
    fast_step(first, 1)
    fast_step(second, 1)
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))

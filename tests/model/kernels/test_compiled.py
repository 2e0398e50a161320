"""The field as one compiled function against its plain twins: values and every gradient, for any number of points."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from chona_model.field.grid import GridField, GridShape
from chona_model.kernels import compiled
from chona_model.kernels.compiled import compiles, fused_field
from chona_model.kernels.reference import encode
from chona_model.kernels.reference.perceptron import perceptron

POSE = 6


def made_field(seed: int = 0, device: str = "cpu") -> GridField:
    torch.manual_seed(seed)
    shape = GridShape(levels=4, coarsest=0.2, finest=0.02, rows=10, pose=4)
    field = GridField(shape, np.zeros((2, 3)), np.ones((2, 3)), 1, POSE).to(device=device, dtype=torch.float64)
    with torch.no_grad():
        field.table.uniform_(-1.0, 1.0)
    return field


def outcome(field: GridField, count: int, fused: bool, shaded: bool, backend: str) -> list[torch.Tensor]:
    """Density, colour, and the gradients of a random sum of them by everything that has one."""
    random = torch.Generator().manual_seed(count)
    device = field.lower.device

    def numbers(*size: int) -> torch.Tensor:
        return torch.rand(*size, generator=random, dtype=torch.float64).to(device)

    points = numbers(count, 3).requires_grad_()
    part, pair, pose = (torch.randint(2, (count,), generator=random).to(device) for _ in range(3))
    pairs = torch.tensor([[0, 0], [0, -1]], device=device)
    weights = field.weights(field.codes(pairs), numbers(2, POSE) if shaded else None)
    head = (points, part.int(), field.table, field.layout)
    if fused:
        density, rgb = fused_field(*head, weights, pair, pose, 50.0, backend)
    else:
        density, rgb = perceptron(encode(*head), weights, pair, pose, 50.0)
    field.zero_grad()
    ((density * numbers(count)).sum() + (rgb * numbers(count, 3)).sum()).backward()
    grads = [parameter.grad for parameter in field.parameters() if parameter.grad is not None]
    return [density.detach(), rgb.detach(), points.grad, *(grad.clone() for grad in grads)]


@pytest.mark.parametrize("shaded", [True, False])
@pytest.mark.parametrize("count", [7, 300])
def test_traced_whole_it_is_the_twins(count: int, shaded: bool) -> None:
    """One graph, without a break, that holds for any number of points."""
    field = made_field()
    one, other = (outcome(field, count, fused, shaded, "aot_eager") for fused in (True, False))
    assert len(one) == len(other) > 8
    for a, b in zip(one, other, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-10)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no graphics card with CUDA")
def test_on_a_graphics_card() -> None:
    field = made_field(device="cuda")
    one, other = (outcome(field, 5000, fused, True, "inductor") for fused in (True, False))
    for a, b in zip(one, other, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-7, atol=1e-8)


def test_without_a_compiler_the_twins_run(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not compiles(torch.zeros(1))
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    compiled._compiler.cache_clear()
    assert not compiled._compiler()
    compiled._compiler.cache_clear()

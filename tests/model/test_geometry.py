"""Distances, boxes, 3x3 inverses and safe functions against closed forms and numpy."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from chona_model.geometry import (
    box_distances,
    inverse_3x3,
    ray_box,
    safe_divide,
    safe_norm,
    safe_sqrt,
    segment_distances,
)


def test_segment_distances_before_beside_and_behind() -> None:
    points = torch.tensor([[-3.0, 4.0, 0.0], [0.5, 2.0, 0.0], [5.0, 0.0, 3.0], [0.25, 0.0, 0.0]])
    distances = segment_distances(points, torch.zeros(3), torch.tensor([1.0, 0.0, 0.0]))
    torch.testing.assert_close(distances, torch.tensor([5.0, 2.0, 5.0, 0.0]))


def test_a_bone_of_zero_length_is_a_point_with_finite_gradients() -> None:
    points = torch.tensor([[3.0, 4.0, 0.0], [1.0, 1.0, 1.0]], requires_grad=True)
    heads = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], requires_grad=True)
    tails = heads.detach().clone().requires_grad_()
    distances = segment_distances(points, heads, tails)
    torch.testing.assert_close(distances, torch.tensor([5.0, 0.0]))
    distances.sum().backward()
    torch.testing.assert_close(points.grad, torch.tensor([[0.6, 0.8, 0.0], [0.0, 0.0, 0.0]]))
    assert heads.grad is not None and torch.isfinite(heads.grad).all()
    assert tails.grad is not None and torch.isfinite(tails.grad).all()


def test_segment_distances_against_dense_sampling() -> None:
    generator = torch.Generator().manual_seed(1)
    points, heads, tails = (torch.rand(40, 3, generator=generator, dtype=torch.float64) for _ in range(3))
    share = torch.linspace(0, 1, 20001, dtype=torch.float64)[:, None, None]
    brute = torch.linalg.vector_norm(points - heads - share * (tails - heads), dim=-1).amin(dim=0)
    torch.testing.assert_close(segment_distances(points, heads, tails), brute, rtol=0, atol=1e-6)


def test_box_distances() -> None:
    lower, upper = torch.tensor([-1.0, -1.0, -1.0]), torch.tensor([1.0, 1.0, 1.0])
    points = torch.tensor([[0.0, 0.0, 0.5], [4.0, 5.0, 0.0], [1.0, 1.0, 3.0]])
    torch.testing.assert_close(box_distances(points, lower, upper), torch.tensor([0.0, 5.0, 2.0]))
    torch.testing.assert_close(box_distances(points, lower, lower)[0], torch.tensor(1 + 1 + 1.5**2).sqrt())


@pytest.mark.parametrize(
    ("origin", "direction", "near", "far", "hit"),
    [
        ((-2, 0.5, 0.5), (1, 0, 0), 2, 3, True),
        ((-2, 1.0, 0.5), (1, 0, 0), 2, 3, True),  # lies in the plane of a face: 0/0 in the usual formula
        ((-2, 0.0, 1.0), (2, 0, 0), 1, 1.5, True),  # lies in an edge
        ((-2, 1.001, 0.5), (1, 0, 0), 0, 0, False),
        ((0.5, 0.5, 0.5), (0, 0, -2), 0, 0.25, True),  # starts inside
        ((2, 0.5, 0.5), (1, 0, 0), 0, 0, False),  # behind
        ((1, 1, 1), (1, 1, 1), 0, 0, True),  # touches a corner and leaves
        ((-1, -1, 0.5), (1, 2, 0), 1, 1, True),  # touches an edge: enters x where it leaves y
        ((-1, -1, 0.5), (1, -1, 0), 0, 0, False),
    ],
)
def test_ray_box(origin: tuple, direction: tuple, near: float, far: float, hit: bool) -> None:
    entered, left, found = ray_box(
        torch.tensor(origin, dtype=torch.float64),
        torch.tensor(direction, dtype=torch.float64),
        torch.zeros(3),
        torch.ones(3),
    )
    assert (float(entered), float(left), bool(found)) == (near, far, hit)


def test_inverse_matches_numpy_at_every_scale() -> None:
    generator = np.random.default_rng(0)
    matrices = generator.normal(size=(200, 3, 3))
    for scale in (1e-12, 1.0, 1e12):
        result = inverse_3x3(torch.tensor(matrices * scale))
        regular = result.regular.numpy()
        assert regular.mean() > 0.95
        product = result.matrix.numpy()[regular] @ (matrices * scale)[regular]
        np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-10)


def test_mirrored_matrices_are_regular() -> None:
    result = inverse_3x3(torch.diag(torch.tensor([1.0, -1.0, 1.0])))
    assert bool(result.regular)
    torch.testing.assert_close(result.matrix, torch.diag(torch.tensor([1.0, -1.0, 1.0])))


def test_a_damped_inverse_still_solves_what_can_be_solved() -> None:
    singular = torch.diag(torch.tensor([2.0, 0.0, 1.0]))
    result = inverse_3x3(singular)
    assert not bool(result.regular)
    step = result.matrix @ torch.tensor([2.0, 1.0, 1.0])
    torch.testing.assert_close(step, torch.tensor([1.0, 0.0, 1.0]), rtol=1e-3, atol=1e-3)


def test_safe_functions_have_the_values_and_gradients_of_the_unsafe_ones() -> None:
    x = torch.tensor([4.0, 0.0, -1.0], requires_grad=True)
    safe_sqrt(x).sum().backward()
    torch.testing.assert_close(x.grad, torch.tensor([0.25, 0.0, 0.0]))
    x = torch.tensor([1.0, 0.0], requires_grad=True)
    quotient = safe_divide(torch.tensor([3.0, 3.0]), x, fallback=7.0)
    torch.testing.assert_close(quotient, torch.tensor([3.0, 7.0]))
    quotient.sum().backward()
    torch.testing.assert_close(x.grad, torch.tensor([-3.0, 0.0]))
    lengths = safe_norm(torch.tensor([[3e30, 4e30], [3e-30, 4e-30], [0.0, 0.0]]))
    torch.testing.assert_close(lengths / torch.tensor([1e30, 1e-30, 1.0]), torch.tensor([5.0, 5.0, 0.0]))

"""Encodings against quadrature and finite differences."""

from __future__ import annotations

import numpy as np
import torch

from chona_model.field.encodings import (
    encoding_size,
    integrated_encoding,
    positional_encoding,
    positional_encoding_tangents,
)


def test_sizes() -> None:
    points = torch.zeros(5, 3)
    assert positional_encoding(points, 4).shape[-1] == encoding_size(4, identity=True) == 27
    assert integrated_encoding(points, points, 10).shape[-1] == encoding_size(10, identity=False) == 60


def test_integrated_encoding_is_the_expectation_under_the_gaussian() -> None:
    """Gauss–Hermite quadrature of sin and cos over each axis; 60 nodes are exact to 1e-12 at these widths."""
    nodes, masses = np.polynomial.hermite_e.hermegauss(60)
    masses = masses / masses.sum()
    mean, deviation, degrees = np.array([0.3, -0.8, 1.1]), np.array([0.2, 0.05, 0.4]), 4
    values = mean[:, None] + deviation[:, None] * nodes
    expected = []
    for function in (np.sin, np.cos):
        expected += [(function(2.0**k * values) * masses).sum(axis=1) for k in range(degrees)]
    got = integrated_encoding(torch.tensor(mean), torch.tensor(deviation**2), degrees)
    np.testing.assert_allclose(got.numpy(), np.concatenate(expected), atol=1e-12)


def test_a_full_covariance_acts_by_its_diagonal() -> None:
    generator = torch.Generator().manual_seed(0)
    root = torch.rand(6, 3, 3, generator=generator, dtype=torch.float64)
    covariance, mean = root @ root.transpose(1, 2), torch.rand(6, 3, generator=generator, dtype=torch.float64)
    diagonal = torch.diagonal(covariance, dim1=-2, dim2=-1)
    torch.testing.assert_close(integrated_encoding(mean, covariance, 5), integrated_encoding(mean, diagonal, 5))


def test_a_point_has_the_plain_encoding() -> None:
    points = torch.rand(7, 3, dtype=torch.float64)
    plain = positional_encoding(points, 6)[:, 3:]
    torch.testing.assert_close(integrated_encoding(points, torch.zeros(7, 3, 3, dtype=torch.float64), 6), plain)


def test_tangents_match_finite_differences() -> None:
    points, step = torch.rand(5, 3, dtype=torch.float64), 1e-6
    tangents = positional_encoding_tangents(points, 4)
    for axis in range(3):
        shift = step * torch.eye(3, dtype=torch.float64)[axis]
        slope = (positional_encoding(points + shift, 4) - positional_encoding(points - shift, 4)) / (2 * step)
        torch.testing.assert_close(tangents[axis], slope, rtol=1e-7, atol=1e-7)

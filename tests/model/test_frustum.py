"""Gaussians of cones and cylinders against exact quadrature over their volume."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from chona_model.render.frustum import conical_frusta, cylinders

ORIGIN = np.array([0.3, -1.0, 2.0])
DIRECTION = np.array([0.4, -0.2, 1.0])


def moments(near: float, far: float, radius: float, *, cone: bool) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance by Gauss–Legendre over depth and radius, and evenly spaced angles: exact for polynomials."""
    nodes, masses = np.polynomial.legendre.leggauss(12)
    depth, depth_mass = 0.5 * (near + far) + 0.5 * (far - near) * nodes, masses
    share, share_mass = 0.5 + 0.5 * nodes, masses
    angle = 2 * np.pi * np.arange(8) / 8
    along = DIRECTION / np.linalg.norm(DIRECTION)
    side = np.cross(along, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(along, side)
    t, r, a = np.meshgrid(depth, share, angle, indexing="ij")
    width = radius * (t if cone else np.ones_like(t))
    points = ORIGIN + t[..., None] * DIRECTION
    points = points + (width * r * np.cos(a))[..., None] * side + (width * r * np.sin(a))[..., None] * up
    mass = depth_mass[:, None, None] * share_mass[None, :, None] * r * width**2
    mass = (mass / mass.sum()).reshape(-1, 1)
    points = points.reshape(-1, 3)
    mean = (mass * points).sum(axis=0)
    return mean, (mass * (points - mean)).T @ (points - mean)


@pytest.mark.parametrize(("near", "far"), [(0.0, 1.0), (0.9, 1.0), (2.0, 2.001), (0.01, 5.0)])
@pytest.mark.parametrize("cone", [True, False])
def test_moments(near: float, far: float, cone: bool) -> None:
    mean, covariance = moments(near, far, 0.1, cone=cone)
    function = conical_frusta if cone else cylinders
    _, means, covariances = function(
        torch.tensor(ORIGIN)[None],
        torch.tensor(DIRECTION)[None],
        torch.tensor([0.1], dtype=torch.float64),
        torch.tensor([[near, far]], dtype=torch.float64),
    )
    np.testing.assert_allclose(means[0, 0].numpy(), mean, rtol=1e-12)
    np.testing.assert_allclose(covariances[0, 0].numpy(), covariance, atol=1e-12)


def test_depth_is_that_of_the_mean_along_the_camera_axis() -> None:
    """DIRECTION has unit length along z, so the mean's z is the depth."""
    edges = torch.linspace(0.5, 3.0, 9, dtype=torch.float64)[None]
    depths, means, _ = conical_frusta(
        torch.zeros(1, 3, dtype=torch.float64), torch.tensor(DIRECTION)[None], torch.tensor([0.1]).double(), edges
    )
    torch.testing.assert_close(means[..., 2], depths)
    assert (depths > edges[:, :-1]).all() and (depths < edges[:, 1:]).all()

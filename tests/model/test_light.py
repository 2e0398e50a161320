"""Light that stays in the world while figures turn."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from chona_model.field.light import COEFFICIENTS, root_light
from chona_model.kernels.reference.light import gains, normals_at, terms
from chona_model.render.normals import surface_normals
from chona_model.render.occupancy import make_occupancy


def random_units(count: int, seed: int = 0) -> torch.Tensor:
    normals = torch.from_numpy(np.random.default_rng(seed).normal(size=(count, 3)))
    return normals / normals.norm(dim=1, keepdim=True)


def world_light(seed: int = 1) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(COEFFICIENTS, 3)))


def test_a_turned_figure_sees_the_same_light_on_the_same_world_normals() -> None:
    turns = Rotation.random(4, random_state=2).as_matrix()
    in_world, normals = root_light(world_light(), np.eye(3)[None])[0], random_units(50)
    for turn, light in zip(turns, root_light(world_light(), turns), strict=True):
        root = normals @ torch.from_numpy(turn).T
        torch.testing.assert_close(gains(root, light), gains(normals, in_world), rtol=1e-10, atol=1e-12)


def test_degree_two_has_no_mean_over_the_sphere() -> None:
    """What the light adds on average is the albedo's to say: otherwise the two could trade for ever."""
    light = root_light(world_light(), np.eye(3)[None])[0]
    points, weights = np.polynomial.legendre.leggauss(8)
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    rings = [np.stack([np.sqrt(1 - z * z) * np.cos(angles), np.sqrt(1 - z * z) * np.sin(angles), np.full(16, z)], 1)
             for z in points]  # fmt: skip
    means = [w * (terms(torch.from_numpy(ring)) @ light).mean(dim=0) for w, ring in zip(weights, rings, strict=True)]
    torch.testing.assert_close(torch.stack(means).sum(dim=0), torch.zeros(3).double(), rtol=0, atol=1e-12)


def test_no_normal_no_light() -> None:
    light = root_light(world_light(), np.eye(3)[None])[0]
    assert torch.equal(gains(torch.zeros(2, 3).double(), light), torch.ones(2, 3).double())


def test_gradients_are_those_of_finite_differences() -> None:
    turns = Rotation.random(2, random_state=3).as_matrix()
    normals, light = random_units(5), (0.3 * world_light()).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: gains(normals, root_light(x, turns)[1]), (light,))


@pytest.fixture
def ball():
    """A hollow ball: its cavity is no surface that anything sees."""
    occupancy = make_occupancy(np.full((1, 3), -0.3), np.full((1, 3), 0.3), 0.02)
    centres = occupancy.centres(0, np.arange(len(occupancy.densities)))
    distance = np.linalg.norm(centres, axis=1)
    occupancy.densities[:] = np.where(np.abs(distance - 0.18) < 0.03, 50.0, 0.0)
    return occupancy


def test_normals_of_a_ball_point_outwards(ball) -> None:
    normals = surface_normals(ball)
    outward = random_units(400).float()
    found = normals_at(
        0.2 * outward, torch.zeros(400, dtype=torch.int32), torch.from_numpy(normals), torch.from_numpy(ball.first),
        torch.from_numpy(ball.dims), torch.from_numpy(ball.origins), 1 / ball.cell,
    )  # fmt: skip
    cosine = (found * outward).sum(dim=1) / found.norm(dim=1)
    assert cosine.min() > np.cos(np.radians(6))


def test_an_empty_part_has_no_normals(ball) -> None:
    ball.densities[:] = 0.0
    assert not surface_normals(ball).any()


def test_a_part_at_its_grids_border_has_normals_too(ball) -> None:
    ball.densities[:] = 0.0
    ball.densities[0] = 50.0
    assert np.isfinite(surface_normals(ball)).all()
    assert surface_normals(ball).any()

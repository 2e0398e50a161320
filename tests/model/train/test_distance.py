"""The distance field of ARAH's methods: its prior against closed forms, and that it stays a distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull
from tiny_capture import SKELETON, tiny_capture
from tiny_models import tiny_trainer

from chona_model.data.dataset import Dataset, ObjectShape, Person, SkinnedSurface
from chona_model.methods import METHODS
from chona_model.train.distance import CAPSULE, EIKONAL_WEIGHT, NEAR, body_distance, ellipsoid_distance, vertex_normals
from chona_model.train.errors import TrainingError
from chona_model.train.exact_trainer import ExactTrainer, PaperSettings


def ball(radius: float) -> SkinnedSurface:
    """A sphere of 2000 vertices whose faces turn outwards."""
    steps = np.arange(2000) + 0.5
    height, angle = 1.0 - 2.0 * steps / 2000, np.pi * (1.0 + 5.0**0.5) * steps
    ring = np.sqrt(1.0 - height**2)
    vertices = radius * np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    faces = ConvexHull(vertices).simplices
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ti,ti->t", across, corners.mean(axis=1)) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return SkinnedSurface(vertices, np.ones((len(vertices), 1)), faces)


POINTS = np.random.default_rng(4).uniform(-0.5, 0.5, (500, 3))


def test_the_distance_to_a_body_model_is_that_of_its_surface() -> None:
    surface = ball(0.3)
    assert np.abs(np.linalg.norm(vertex_normals(surface), axis=1) - 1.0).max() < 1e-9
    found = body_distance(Person("one", np.zeros((3, 3)), surface), SKELETON, POINTS)
    expected = np.linalg.norm(POINTS, axis=1) - 0.3
    assert np.abs(found - expected).max() < 0.01  # vertices lie 2 cm apart
    clear = np.abs(expected) > 0.01
    assert (np.sign(found[clear]) == np.sign(expected[clear])).all()


def test_without_a_body_model_bones_are_capsules() -> None:
    joints = np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.6, 0.0]])
    points = np.array([[0.1, 0.15, 0.0], [0.0, 0.3, 0.02], [0.0, -0.2, 0.0]])
    found = body_distance(Person("one", joints), SKELETON, points)
    assert np.allclose(found, np.array([0.1, 0.02, 0.2]) - CAPSULE)


def test_the_distance_to_an_ellipsoid_is_right_on_its_axes_and_exact_for_a_ball() -> None:
    shape = ObjectShape("ball", np.full(3, -0.25), np.full(3, 0.25))
    assert np.allclose(ellipsoid_distance(shape, POINTS), np.linalg.norm(POINTS, axis=1) - 0.2)
    flat = ObjectShape("disc", np.array([-0.5, -0.5, -0.1]), np.array([0.5, 0.5, 0.1]))
    found = ellipsoid_distance(flat, np.array([[0.4, 0.0, 0.0], [0.0, 0.0, 0.08], [0.0, 0.0, 0.081], [0.0, 0.0, 0.0]]))
    assert np.allclose(found, [0.0, 0.0, 0.001, -0.08], atol=1e-4)


@pytest.fixture
def capture(tmp_path: Path) -> Dataset:
    return tiny_capture(tmp_path)


def test_training_begins_with_the_prior_and_keeps_a_distance(capture: Dataset) -> None:
    trainer = tiny_trainer(capture, method=METHODS["arah-object"])
    distances = trainer.distances
    assert distances is not None
    for part in range(2):
        points = distances._points(part, 2000, np.random.default_rng(0))
        with torch.no_grad():
            found = distances._distance(part, points).numpy()
        wanted = np.clip(distances._prior(part, points), -NEAR, NEAR)
        assert np.sqrt(((found - wanted) ** 2).mean()) < 0.25 * wanted.std() + 0.004

    def slope() -> float:
        """How far the gradient's length is from 1, root mean square."""
        with torch.no_grad():
            return float(np.sqrt(np.mean([float(distances.eikonal(step)) / EIKONAL_WEIGHT for step in range(16)])))

    for index in range(60):
        trainer.step(index, index / 60)
    held = slope()
    free = tiny_trainer(capture)
    for index in range(60):
        free.step(index, index / 60)
    distances.model, distances.pair = free.model, free._usual_pair
    assert held < 0.5 * slope(), (held, slope())  # a free density is no distance


def test_the_paper_preset_says_that_it_has_no_distances(capture: Dataset) -> None:
    with pytest.raises(TrainingError, match="the method arah is trained with preset fast"):
        ExactTrainer(capture, PaperSettings(), 0, method=METHODS["arah"])

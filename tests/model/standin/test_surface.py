"""Surfaces of forms that are known: where they lie, that they are closed, what is kept and what is dropped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import FormPart, ball, edges_are_shared, pieces, shade, union, volume

from chona_model.standin.attributes import BONES, FAINT, colours, strongest
from chona_model.standin.surface import EDGE, clean, extract, fair, light_in, limited, measure, snap

VOXEL = 0.02


def nothing(_count: int) -> None:
    """No progress."""


def lattice(part: FormPart, smallest: float = 0.06, voxel: float = VOXEL):
    return clean(light_in(measure(part, voxel, nothing)), smallest)


@pytest.mark.parametrize("sharp", [False, True])
@pytest.mark.parametrize("inside", [30.0, 400.0])
@pytest.mark.parametrize("voxel", [0.015, 0.02])
def test_a_balls_surface_lies_where_light_has_come_so_far(inside: float, voxel: float, sharp: bool) -> None:
    """Along the radius light falls as exp(−density · depth): the surface is ln(1 / EDGE) / density deep."""
    part = FormPart(ball(0.3), inside, sharp)
    surface = snap(part, extract(lattice(part, voxel=voxel)[0]), voxel, nothing)
    away = np.linalg.norm(surface.vertices, axis=1) - (0.3 - np.log(1.0 / EDGE) / inside)
    # Averages over cubes, a quarter of a voxel wide, begin half of that before a wall.
    assert abs(away.mean() - (0.0 if sharp else voxel / 16.0)) < 0.1 * voxel
    assert np.abs(away).max() < voxel / 3.0  # rays are sampled a quarter of a voxel apart, and neighbours averaged
    assert edges_are_shared(surface.faces)


def test_surfaces_are_closed_and_face_outwards() -> None:
    part = FormPart(ball(0.3), 400.0)
    surface = snap(part, extract(lattice(part)[0]), VOXEL, nothing)
    assert edges_are_shared(surface.faces)
    assert len(surface.vertices) - 3 * len(surface.faces) // 2 + len(surface.faces) == 2  # Euler: a sphere
    assert volume(surface.vertices, surface.faces) == pytest.approx(4.0 / 3.0 * np.pi * 0.3**3, rel=0.03)
    outwards = surface.vertices / np.linalg.norm(surface.vertices, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-9)
    assert (surface.normals * outwards).sum(axis=1).min() > 0.97


def test_a_part_that_fills_its_box_is_closed_all_the_same() -> None:
    part = FormPart(ball(2.0), 400.0)
    surface = snap(part, extract(lattice(part)[0]), VOXEL, nothing)
    assert edges_are_shared(surface.faces)
    assert volume(surface.vertices, surface.faces) == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize(("opacity", "shown"), [(0.35, False), (0.7, True)])
def test_sheets_are_shown_from_half_opaque(opacity: float, shown: bool) -> None:
    """A sheet four centimetres thick, in no voxel of which more than a fifth is stopped."""
    part = FormPart(lambda points: np.maximum(np.abs(points[:, 1]) - 0.02, np.abs(points).max(axis=1) - 0.4),
                    -np.log(1.0 - opacity) / 0.04)  # fmt: skip
    surface = extract(lattice(part, voxel=0.01)[0])
    assert (surface is not None) == shown
    if surface is not None:
        assert np.abs(surface.vertices[:, 1]).max() < 0.02 and edges_are_shared(surface.faces)


def test_what_no_light_reaches_is_solid() -> None:
    """A box with walls of 4 cm and nothing inside has no inner surface."""
    hollow = FormPart(lambda points: np.abs(np.abs(points).max(axis=1) - 0.28) - 0.02, 400.0)
    surface = snap(hollow, extract(lattice(hollow)[0]), VOXEL, nothing)
    assert pieces(surface) == 1
    assert volume(surface.vertices, surface.faces) == pytest.approx(0.6**3, rel=0.03)


def test_pieces_apart_are_kept_and_floaters_are_dropped() -> None:
    """A second piece of 12 cm is as real as the first; specks of 6 cm are not."""
    form = union(ball(0.15), ball(0.06, (0.0, 0.35, 0.0)), ball(0.03, (0.35, 0.0, 0.0)), ball(0.03, (-0.35, 0.3, 0.2)))
    kept, dropped = lattice(FormPart(form, 400.0), smallest=0.15)
    assert dropped == 2
    surface = extract(kept)
    assert pieces(surface) == 2 and edges_are_shared(surface.faces)
    assert surface.vertices[:, 1].max() == pytest.approx(0.41, abs=VOXEL)
    # A thing that is small as a whole is no floater.
    small, none = lattice(FormPart(ball(0.03), 400.0), smallest=0.5)
    assert none == 0 and pieces(extract(small)) == 1


def test_fewer_faces_are_still_closed_and_where_they_were() -> None:
    light, _ = lattice(FormPart(union(ball(0.3), ball(0.1, (0.0, 0.4, 0.0))), 400.0), voxel=0.015)
    fine = extract(light)
    used, coarse = limited(light, len(fine.faces) // 6)
    assert len(fine.faces) // 12 < len(coarse.faces) <= len(fine.faces) // 6
    assert used.voxel > 2.0 * light.voxel
    assert edges_are_shared(coarse.faces) and volume(coarse.vertices, coarse.faces) > 0
    away = union(ball(0.3), ball(0.1, (0.0, 0.4, 0.0)))(coarse.vertices)
    assert np.abs(away).max() < 0.7 * used.voxel
    assert limited(light, None)[1].faces.shape == fine.faces.shape


@pytest.mark.parametrize(("wavelength", "low", "high"), [(3, 0.0, 0.3), (12, 0.95, 1.0)])
def test_grain_is_smoothed_and_limbs_stay(wavelength: float, low: float, high: float) -> None:
    """Bumps of so many voxels on a ball, a fifth of a voxel high: the share of them that is left; the ball's size."""
    part = FormPart(ball(0.3), 400.0)
    rough = extract(lattice(part)[0])
    normals = rough.vertices / np.linalg.norm(rough.vertices, axis=1, keepdims=True)
    bumps = np.prod(np.sin(2.0 * np.pi * rough.vertices[:, :2] / (wavelength * VOXEL)), axis=1)
    bumpy = replace(rough, vertices=normals * (0.3 + 0.2 * VOXEL * bumps)[:, None])
    away = np.linalg.norm(fair(bumpy).vertices, axis=1) - 0.3
    front = np.abs(normals[:, 2]) > 0.9
    left = (away * bumps)[front].sum() / (0.2 * VOXEL * (bumps[front] ** 2).sum())
    assert low < left < high
    assert abs(away.mean()) < 0.01 * VOXEL


def test_nothing_opaque_has_no_surface() -> None:
    assert extract(lattice(FormPart(ball(0.3), 0.1))[0]) is None


def test_colours_are_the_fields_on_the_surface() -> None:
    """The mean of a linear colour over the light that a ray loses is the colour at the light's mean depth."""
    part = FormPart(ball(0.3), 200.0)
    surface = snap(part, extract(lattice(part)[0]), VOXEL, nothing)
    found = colours(part, surface.vertices, surface.normals, VOXEL, nothing)
    radial = surface.vertices / np.linalg.norm(surface.vertices, axis=1, keepdims=True)
    np.testing.assert_allclose(found, shade(radial * (0.3 - 1.0 / 200.0)), atol=0.01)


def test_four_bones_at_most_and_none_that_hardly_weighs() -> None:
    rows = np.array(
        [[0.5, 0.2, 0.15, 0.1, 0.05], [0.986, 0.008, 0.006, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0], [0.2] * 5]
    )
    bones, weights = strongest(rows)
    np.testing.assert_array_equal(bones[0], [0, 1, 2, 3])
    np.testing.assert_allclose(weights[0], np.array([0.5, 0.2, 0.15, 0.1]) / 0.95, rtol=1e-6)
    np.testing.assert_array_equal(bones[1:3], [[0, -1, -1, -1]] * 2)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-6)
    assert (weights[bones >= 0] >= FAINT).all() and (weights[bones < 0] == 0).all()
    few, single = strongest(np.ones((2, 1)))
    assert few.shape == single.shape == (2, BONES) and (few[:, 0] == 0).all() and (few[:, 1:] == -1).all()

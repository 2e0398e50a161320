"""BEHAVE's reader and the body model against the benchmark's own meshes and masks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from chona_model.data.behave import UPRIGHT, read_behave
from chona_model.data.behave_objects import read_ply_vertices
from chona_model.data.body_model import read_body_model, reduced_pose
from chona_model.data.dataset import Dataset, View
from chona_model.data.images import load_pixels
from chona_model.data.restricted_pickle import read_pickle
from chona_model.skeleton import canonical_to_world

SEQUENCES = ("Date01_Sub01_chairwood_hand", "Date02_Sub02_boxlarge_hand")


@pytest.fixture(scope="module")
def dataset(hoibench: Path) -> Dataset:
    return read_behave(hoibench / "behave", SEQUENCES)


@pytest.fixture(scope="module")
def frames(dataset: Dataset) -> list[View]:
    """One view of each frame."""
    return list({(view.sequence, view.frame): view for view in dataset.views}.values())


@pytest.mark.parametrize("bones", [52, 24])
def test_posed_vertices_equal_the_registered_mesh(hoibench: Path, frames: list[View], bones: int) -> None:
    for view in frames:
        folder = view.image.parent / "person" / "fit02"
        fit = read_pickle(folder / "person_fit.pkl")
        model = read_body_model(hoibench / "smplh" / f"SMPLH_{'male' if 'Sub01' in view.sequence else 'female'}.npz")
        pose = fit["pose"]
        if bones == 24:
            model, pose = model.reduced(), reduced_pose(pose)
        posed = model.posed(pose, fit["betas"], fit["trans"])
        assert np.abs(posed - read_ply_vertices(folder / "person_fit.ply")).max() < 1e-6


def test_bone_frames_move_the_surface_onto_the_registered_mesh(dataset: Dataset, frames: list[View]) -> None:
    for view in frames:
        person = dataset.persons[view.pose.person or ""]
        assert person.surface is not None
        transforms = canonical_to_world(UPRIGHT.T @ view.pose.world_from_bone, person.rest_joints)
        blended = np.einsum("vb,bij->vij", person.surface.weights, transforms)
        moved = np.einsum("vij,vj->vi", blended[:, :3, :3], person.surface.vertices) + blended[:, :3, 3]
        registered = read_ply_vertices(view.image.parent / "person" / "fit02" / "person_fit.ply")
        assert np.abs(moved - registered).max() < 1e-6


def test_the_template_under_the_object_frame_equals_its_registered_mesh(
    hoibench: Path, dataset: Dataset, frames: list[View]
) -> None:
    for view in frames:
        (name,) = view.pose.objects
        template = read_ply_vertices(next((hoibench / "behave" / "objects" / name).glob("*_f*.ply")))
        centred = template - template.mean(0)
        frame = UPRIGHT.T @ view.pose.world_from_object[0]
        registered = read_ply_vertices(view.image.parent / name / "fit01" / f"{name}_fit.ply")
        assert np.abs(centred @ frame[:3, :3].T + frame[:3, 3] - registered).max() < 1e-6
        shape = dataset.objects[name]
        assert (centred >= shape.lower - 1e-9).all()
        assert (centred <= shape.upper + 1e-9).all()


def _silhouette(view: View, dataset: Dataset, shift: float = 0.0) -> np.ndarray:
    """The person's mesh drawn by filled triangles, at four times the resolution."""
    person = dataset.persons[view.pose.person or ""]
    assert person.surface is not None
    registered = read_ply_vertices(view.image.parent / "person" / "fit02" / "person_fit.ply")
    pixels, _ = view.camera.project(registered @ UPRIGHT[:3, :3].T)
    image = Image.new("L", (view.camera.width * 4, view.camera.height * 4))
    draw = ImageDraw.Draw(image)
    for triangle in pixels[person.surface.faces] + shift:
        draw.polygon([tuple(corner) for corner in (triangle * 4 - 0.5)], fill=255)
    return np.asarray(image) > 0


def test_the_projected_body_covers_the_mask(dataset: Dataset) -> None:
    for view in (dataset.views[0], dataset.views[1], dataset.views[-1]):
        pixels = load_pixels(view)
        drawn = _silhouette(view, dataset).reshape(view.camera.height, 4, view.camera.width, 4).mean((1, 3)) > 0.5
        # What the object hides is not in the person's mask; elsewhere the two agree.
        visible = ~pixels.object
        union = ((drawn | pixels.person) & visible).sum()
        assert (drawn & pixels.person).sum() / union > 0.92
        assert pixels.mask[drawn].mean() > 0.9


def test_half_a_pixel_is_seen(dataset: Dataset) -> None:
    """The silhouette meets the mask best where the reader puts it: this fails if the half pixel is dropped."""
    shifts = (-1.0, -0.5, 0.0, 0.5, 1.0)
    agreement = np.zeros(len(shifts))
    for view in dataset.views[:8]:
        pixels = load_pixels(view)
        person = pixels.person.repeat(4, 0).repeat(4, 1)
        visible = ~pixels.object.repeat(4, 0).repeat(4, 1)
        for index, shift in enumerate(shifts):
            drawn = _silhouette(view, dataset, shift)
            agreement[index] += ((drawn & person).sum() / ((drawn | person) & visible).sum()) / 8
    assert shifts[int(agreement.argmax())] == 0.0


def test_smpl_in_a_pickle_with_a_sparse_regressor_equals_its_npz(hoibench: Path) -> None:
    plain, pickled = (read_body_model(hoibench / "smplh" / f"SMPL_NEUTRAL.{suffix}") for suffix in ("npz", "pkl"))
    assert np.abs(plain.joints - pickled.joints).max() < 1e-12
    assert (plain.weights == pickled.weights).all()


def test_regressed_joints_are_those_stored(hoibench: Path) -> None:
    path = hoibench / "smplh" / "SMPLH_female.npz"
    with np.load(path) as content:
        stored = content["J"]
    assert np.abs(read_body_model(path).joints - stored).max() < 1e-6

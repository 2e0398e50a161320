"""Where objects stand in canonical space, and poses of several objects."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chona_model.figure import OBJECT_CLEARANCE, Rig, make_figure, object_places
from chona_model.render.posed import slot_matrices
from chona_model.skeleton import Skeleton

SKELETON = Skeleton(("pelvis", "spine"), (-1, 0))
JOINTS = np.array([[0.0, 0.9, 0.0], [0.0, 1.2, 0.0]])


def test_the_first_object_stands_in_front() -> None:
    np.testing.assert_array_equal(object_places(1.1, 1), [[0.0, 0.0, 1.1]])
    assert object_places(1.1, 0).shape == (0, 3)


@pytest.mark.parametrize("slots", [2, 3, 6])
def test_objects_that_fit_the_distance_never_touch(slots: int) -> None:
    distance = 1.1
    places = object_places(distance, slots)
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)[~np.eye(slots, dtype=bool)]
    assert apart.min() > 2 * (distance - OBJECT_CLEARANCE)
    assert np.linalg.norm(places, axis=-1).min() >= distance


def test_every_object_of_a_pose_has_a_canonical_place_of_its_own() -> None:
    """Canonical points of each object's frame reach its own posed frame, and root space leads back."""
    rig = Rig(SKELETON, JOINTS, 0.9)
    bones = np.broadcast_to(np.eye(4), (2, 4, 4)).copy()
    bones[:, :3, 3] = JOINTS + [3.0, 0.0, 1.0]
    bones[:, :3, :3] = Rotation.from_euler("y", 0.8).as_matrix()
    objects = np.broadcast_to(np.eye(4), (3, 4, 4)).copy()
    objects[:, :3, :3] = Rotation.from_rotvec([[0.1, 0.2, 0.3], [1.0, 0.0, 0.0], [0.0, -2.0, 0.0]]).as_matrix()
    objects[:, :3, 3] = [[3.5, 1.0, 1.2], [2.0, 0.5, 1.0], [3.0, 2.0, 0.0]]
    figure = make_figure(rig, bones, objects, 4)
    assert figure.present.tolist() == [True] * 5 + [False]
    local = np.array([0.1, -0.2, 0.05])
    places = rig.canonical_objects(4)
    back = slot_matrices(figure, 2, places)
    for slot in range(3):
        world = objects[slot, :3, :3] @ local + objects[slot, :3, 3]
        root = figure.root_from_world[:3, :3] @ world + figure.root_from_world[:3, 3]
        posed = figure.transforms[2 + slot]
        np.testing.assert_allclose(posed[:3, :3] @ (places[slot] + local) + posed[:3, 3], root, atol=1e-12)
        np.testing.assert_allclose(back[slot, :, :3] @ root + back[slot, :, 3], local, atol=1e-6)

"""One figure sampled from armatures that differ in unit, axes, rolls, parents and what moves them."""

from __future__ import annotations

import numpy as np
import pytest
from operation_helpers import FIGURE, bpy_pythons, run_bpy, write_header_only_model
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.bpy
NAMES = [name for name, _, _ in FIGURE]


@pytest.fixture(scope="module", params=bpy_pythons())
def found(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Every case's sampled pose or message."""
    model = write_header_only_model(tmp_path_factory.mktemp("sampling") / "model.safetensors")
    return run_bpy(request.param, "rig_sampling.py", model)


def test_the_motion_is_the_one_that_was_keyed(found: dict) -> None:
    """Forward kinematics of the keyed rotations, written again with scipy."""
    joints = np.array([joint for _, _, joint in FIGURE])
    place = np.eye(4)
    place[:3, :3] = Rotation.from_euler("ZX", [0.7, np.pi / 2]).as_matrix()
    place[:3, 3] = 0.4, -1.1, 0.2
    sampled = np.array(found["plain"]["bones"])
    for index, frame in ((0, 1), (2, 5)):
        random = np.random.default_rng(frame)
        bones: list[np.ndarray] = []
        for bone, (name, parent, joint) in enumerate(FIGURE):
            local = np.eye(4)
            local[:3, :3] = Rotation.from_euler("xyz", random.normal(0, 0.4, 3)).as_matrix()
            local[:3, 3] = joint if parent < 0 else np.subtract(joint, joints[parent])
            if name == "pelvis":
                local[:3, 3] += random.normal(0, 0.3, 3)
            bones.append((place if parent < 0 else bones[parent]) @ local)
            np.testing.assert_allclose(sampled[index, bone], bones[bone], atol=2e-6)


@pytest.mark.parametrize("case", ["centimetres", "y_up", "rolled", "parented"])
def test_unit_axes_rolls_and_parents_do_not_matter(found: dict, case: str) -> None:
    np.testing.assert_allclose(found[case]["bones"], found["plain"]["bones"], atol=1e-5)
    assert found[case]["scale"] == pytest.approx(1.0, abs=1e-5)
    assert found[case]["dropped"] == []


def test_a_larger_figure_keeps_its_pose_and_tells_its_scale(found: dict) -> None:
    """The figure's own metres: Blender's world divided by its scale."""
    larger, plain = np.array(found["larger"]["bones"]), np.array(found["plain"]["bones"])
    assert found["larger"]["scale"] == pytest.approx(1.5, rel=1e-5)
    np.testing.assert_allclose(larger[..., :3, :3], plain[..., :3, :3], atol=1e-5)
    offset = np.array([0.4, -1.1, 0.2])
    np.testing.assert_allclose(larger[..., :3, 3], plain[..., :3, 3] - offset + offset / 1.5, atol=1e-5)
    linear = np.array(found["larger"]["objects"])[..., :3, :3]
    np.testing.assert_allclose(linear @ linear.swapaxes(-1, -2), np.broadcast_to(np.eye(3), linear.shape), atol=1e-6)


def test_a_little_stretch_is_dropped_and_told(found: dict) -> None:
    case = found["little_stretch"]
    np.testing.assert_allclose(case["bones"], found["plain"]["bones"], atol=1e-5)
    ((name, frame, scale, shear),) = case["dropped"]
    assert (name, frame) == ("left_ankle", 3)
    assert (scale, shear) == (pytest.approx(1.02, abs=1e-4), pytest.approx(0.06, abs=1e-4))


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("stretched", "Bone 'left_ankle' is stretched to 1–1.4 times the figure's scale in frame 3"),
        ("mirrored", "Bone 'pelvis' is mirrored (a negative scale) in frame 1"),
        ("flat", "Bone 'head' has zero scale along an axis in frame 1: give it a scale above zero"),
        ("edited", "Armature 'Robin' is being edited. Leave edit mode first"),
        ("resting", "Armature 'Robin' shows its rest position. Set it to Pose Position"),
    ],
)
def test_what_has_no_rigid_pose_is_refused_by_name_and_frame(found: dict, case: str, words: str) -> None:
    assert words in found[case].get("error", "was sampled")


def test_a_rigid_body_simulation_moves_objects_and_what_hangs_on_them(found: dict) -> None:
    """The animator's scene is played from the first frame: a free fall, which an empty under the cube shares."""
    case = found["falling"]
    heights = np.array(case["objects"])[:, 0, 2, 3]
    np.testing.assert_allclose(heights, case["played"], atol=1e-6)
    seconds = (np.array(case["frames"]) - 1) / 24.0
    np.testing.assert_allclose(heights, 5.0 - 0.5 * 9.81 * seconds**2, atol=0.06)
    assert case["frame"] == 4 and case["unkeyed"] == pytest.approx(0.123)


def test_between_frames_a_simulation_lies_between_its_frames(found: dict) -> None:
    """Shutters that reach before and after their frame, read while it is played; whole frames come out the same."""
    case = found["falling"]
    frames, moments = np.array([5, 6, 9]), np.array([0.0, -0.5, 0.25, 0.75])
    heights = np.array(case["shutter"])
    assert heights[1, 0] == pytest.approx(case["played"][1], abs=1e-6)
    seconds = (frames[:, None] + moments - 1) / 24.0
    np.testing.assert_allclose(heights, 5.0 - 0.5 * 9.81 * seconds**2, atol=0.05)
    order = np.argsort((frames[:, None] + moments).ravel())
    assert (np.diff(heights.ravel()[order]) < -0.005).all(), "it falls from moment to moment"


def test_constraints_drivers_and_parents_count(found: dict) -> None:
    """IK, a driver and a bone-parented empty, as Blender evaluates them in the user's scene."""
    case = found["controlled"]
    assert max(case["reached"]) < 1e-3, "the IK target must be reached, else this shows nothing"
    rest = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    evaluated, sampled = np.array(case["evaluated"]), np.array(case["bones"])
    np.testing.assert_allclose(sampled[..., :3, :3], evaluated[..., :3, :3] @ rest, atol=1e-5)
    joints = np.array([joint for _, _, joint in FIGURE])
    heads = np.einsum("fbij,bj->fbi", evaluated[..., :3, :3], joints @ rest.T) + evaluated[..., :3, 3]
    np.testing.assert_allclose(sampled[..., :3, 3], heads, atol=1e-5)
    np.testing.assert_allclose(case["objects"], np.array(case["held"])[:, None], atol=1e-5)
    neck, head = NAMES.index("neck"), NAMES.index("head")
    nods = [
        np.linalg.norm(Rotation.from_matrix(frame[neck, :3, :3].T @ frame[head, :3, :3]).as_rotvec())
        for frame in sampled
    ]
    np.testing.assert_allclose(nods, [0.0, 0.4, 0.8], atol=1e-5)


def test_sampling_leaves_unkeyed_edits_frame_and_selection_alone(found: dict) -> None:
    assert found["controlled"]["unchanged"] is True

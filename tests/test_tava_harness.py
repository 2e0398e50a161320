"""What benchmarks/tava.py hands to TAVA: bones, clusters and pose codes in its conventions."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chona_model.data.opener import open_dataset
from chona_model.skeleton import SMPL, forward_kinematics

FILE = Path(__file__).resolve().parents[1] / "benchmarks" / "tava.py"
ZJU_CLUSTERS = [0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18]
"""RIGID_BONE_IDS of its datasets/zju_parser.py, whose joints are SMPL's in SMPL's order."""


@pytest.fixture
def harness(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The harness as a module; TAVA's modules are forgotten afterwards."""
    spec = importlib.util.spec_from_file_location("benchmarks_tava", FILE)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "benchmarks_tava", module)
    spec.loader.exec_module(module)
    yield module
    for name in [name for name in sys.modules if name.split(".")[0] == "tava"]:
        del sys.modules[name]


def test_bones_and_clusters_are_those_of_tavas_people(harness: ModuleType) -> None:
    heads, tails = harness.bone_ends(SMPL)
    assert tails.tolist() == list(range(1, 24))
    assert heads.tolist() == list(SMPL.parents[1:])
    assert harness.rigid_clusters(SMPL).tolist() == ZJU_CLUSTERS


def test_pose_latent_gives_back_the_rotations_a_pose_was_made_of(harness: ModuleType) -> None:
    generator = np.random.default_rng(0)
    joints, angles = generator.normal(size=(24, 3)), generator.normal(scale=0.5, size=(24, 3))
    moved = generator.normal(size=3)
    world_from_bone = forward_kinematics(SMPL, joints, Rotation.from_rotvec(angles).as_matrix(), moved)
    latent = harness.pose_latent(SMPL, joints, world_from_bone)
    root = Rotation.from_rotvec(angles[0]).as_matrix()
    translation = joints[0] + moved - root @ joints[0]  # the root turns about the origin, then moves
    expected = np.concatenate([np.zeros(3), angles[1:].ravel(), angles[0], translation])
    assert latent.shape == (78,)
    np.testing.assert_allclose(latent, expected, atol=1e-12)


def test_modules_come_from_the_checkout_whatever_else_is_named_tava(
    harness: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, folder in harness.MODULES.items():
        file = tmp_path / "tava" / folder / f"{name.replace('.', '/')}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("")
    monkeypatch.syspath_prepend(FILE.parent)  # where benchmarks/tava.py would be found first
    found = harness.import_tava(tmp_path)
    assert Path(found.snarf.__file__) == tmp_path.resolve() / "tava" / "models" / "deform_posi_enc" / "snarf.py"
    with pytest.raises(SystemExit, match="no checkout of TAVA"):
        harness.import_tava(tmp_path / "absent")


def test_its_rays_and_transforms_are_ours(harness: ModuleType, hoibench: Path) -> None:
    if "CHONA_TAVA" not in os.environ:
        pytest.skip("no checkout of TAVA; name its folder in CHONA_TAVA")
    tava = harness.import_tava(Path(os.environ["CHONA_TAVA"]))
    dataset = open_dataset(hoibench / "behave", "behave", sequences=["Date01_Sub01_chairwood_sit"])
    view, pixels = dataset.views[5], np.array([[120, 200], [200, 260], [383, 511]])
    shot = harness.make_shot(tava, dataset, view, pixels)
    origins, directions = view.camera.rays(pixels[:, ::-1] + 0.5)
    np.testing.assert_allclose(shot.rays.origins, origins, atol=1e-6)
    np.testing.assert_allclose(shot.rays.directions, directions, atol=1e-6)
    joints = dataset.persons[view.pose.person].rest_joints
    moved = harness.canonical_to_world(view.pose.world_from_bone, joints)[list(SMPL.parents[1:])]
    posed, rest = (shot.frame[name].transforms.numpy() for name in ("bones_posed", "bones_rest"))
    np.testing.assert_allclose(posed @ np.linalg.inv(rest), moved, atol=1e-5)
    # Ends of the parent's bone stay together: its frame carries the canonical tail to the posed one.
    tails = np.concatenate([shot.frame["bones_rest"].tails.numpy(), np.ones((23, 1))], axis=1)
    carried = np.einsum("jab,jb->ja", moved, tails)[:, :3]
    np.testing.assert_allclose(carried, shot.frame["bones_posed"].tails, atol=2e-3)

"""A posed armature in Blender and the same pose given to ``chona_model`` directly give the same image."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_models import trained

from chona_model.camera import Camera
from chona_model.data.dataset import Pose
from chona_model.formats.exr import read_frame
from chona_model.frame import linear_from_srgb
from chona_model.model_store import save_actor
from chona_model.settings import RENDER_PRESETS
from chona_model.skeleton import forward_kinematics

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.bpy


@pytest.fixture(params=[p for p in os.environ.get("CHONA_BPY", "").split(os.pathsep) if p] or [""])
def posed(request, tmp_path):
    """Runs the posing script in Blender; returns the actor, rotations, where things stand, and the shot."""
    if not request.param:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    _, trainer = trained()
    actor = trainer.actor()
    save_actor(tmp_path / "model.safetensors", actor, "chona", {}, {})
    local = Rotation.from_rotvec([[0.1, 0.2, -0.3], [0.5, -0.1, 0.2], [-0.2, 0.6, 0.1]]).as_matrix()
    np.savez(tmp_path / "rotations.npz", local=local)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [request.param, str(Path(__file__).parent / "scripts" / "pose_parity.py"), str(tmp_path / "model.safetensors"),
         str(tmp_path / "rotations.npz"), str(tmp_path / "parity.shot.npz")],
        env=environment | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    placed = json.loads([line for line in done.stdout.splitlines() if line.startswith("{")][-1])
    return actor, local, placed, tmp_path


def test_the_same_pose_gives_the_same_image(posed) -> None:
    actor, local, placed, folder = posed
    done = subprocess.run(
        [sys.executable, "-m", "chona_model", "bake", "--model", folder / "model.safetensors",
         "--shot", folder / "parity.shot.npz", "--out", folder / "out", "--frames", "2", "--preset", "final"],
        capture_output=True, text=True, timeout=300, check=False, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    layers, header = read_frame(folder / "out" / "parity_0002.exr")

    # The same by hand: kinematics in canonical axes, the armature's matrix, OpenCV axes, the formula of the lens.
    (person,) = actor.persons.values()
    blender_from_canonical = np.eye(4)
    blender_from_canonical[:3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    armature = np.array(placed["armature"]) @ blender_from_canonical
    bones = armature @ forward_kinematics(actor.skeleton, person.rest_joints, local, np.zeros(3))
    thing = np.array(placed["object"])
    focal = placed["lens"] / placed["sensor"] * 80
    intrinsics = np.array([[focal, 0, 40 - placed["shift_x"] * 80], [0, focal, 30], [0, 0, 1.0]])
    camera = Camera(intrinsics, np.array(placed["camera"]) @ np.diag([1.0, -1.0, -1.0, 1.0]), 80, 60)
    pose = Pose(person.name, tuple(actor.objects), bones, thing[None])
    picture = actor.render(pose, camera, RENDER_PRESETS["final"])

    assert header.frame == 2
    assert picture.alpha.max() > 0.9, "the figure must be in the picture"
    alpha = layers.combined[..., 3]
    # Blender's matrices are float32: samples on the border of an occupancy cell may fall to its other side.
    np.testing.assert_allclose(alpha, picture.alpha, atol=2e-2)
    assert np.abs(alpha - picture.alpha).mean() < 2e-4
    straight = picture.rgb / np.maximum(picture.alpha, 1e-6)[..., None]
    linear = linear_from_srgb(np.clip(straight, 0, 1)) * picture.alpha[..., None]
    np.testing.assert_allclose(layers.combined[..., :3], linear, atol=2e-2)
    solid = picture.alpha > 0.5
    np.testing.assert_allclose(layers.depth[solid], picture.depth[solid], atol=1e-2)
    assert np.abs(layers.depth[solid] - picture.depth[solid]).mean() < 5e-4

"""Stand-ins in Blender: where rigs carry them, what renders see of them, and that nothing is left behind."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy

pytestmark = pytest.mark.bpy
STRUCTURE = {"mpfb default", "mpfb cmu"}
"""Rigs with bones between hips and thighs, which the test turns as if they were limbs."""


@pytest.fixture(scope="module", params=bpy_pythons())
def rigs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Distances to forward skinning."""
    return run_bpy(request.param, "stand_in_rigs.py", tmp_path_factory.mktemp("rigs"))


@pytest.fixture(scope="module", params=bpy_pythons())
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Everything else."""
    return run_bpy(request.param, "stand_in_scene.py", tmp_path_factory.mktemp("scene"))


def test_on_the_models_own_rig_the_mesh_is_forward_skinned(rigs: dict) -> None:
    """The same weights and matrices: only rounding is between them."""
    assert rigs["own"]["largest"] < 2e-5 and rigs["own"]["moved"] > 1.0
    assert rigs["own"]["missing"] == []


def test_every_family_of_rigs_with_the_figures_proportions(rigs: dict) -> None:
    """A-poses blend twice, at rest and posed: that is what is left of up to 2 cm."""
    assert len(rigs["families"]) >= 13
    for name, case in rigs["families"].items():
        assert case["missing"] == [], name
        assert case["moved"] > 0.5, name
        assert case["largest"] < (0.05 if name in STRUCTURE else 0.02), (name, case)
        assert case["mean"] < 0.005, (name, case)
        assert rigs["figures"][name]["largest"] < 0.036, (name, rigs["figures"][name])
    assert rigs["turned"]["largest"] < 0.02
    assert rigs["giant"]["scale"] == pytest.approx(5.0, rel=1e-4) and rigs["giant"]["largest"] < 5.0 * 0.02


def test_a_rig_of_another_body_needs_the_figures_own_proportions(rigs: dict) -> None:
    """Rigify's metarig has other arms and another spine than the figure: hands are 30 cm off, or 7."""
    by_rig, by_figure = rigs["rigify"]["RIG"], rigs["rigify"]["FIGURE"]
    assert by_figure["largest"] < 0.08 and by_figure["mean"] < 0.025
    assert by_rig["largest"] > 3.0 * by_figure["largest"]


def test_what_cannot_carry_a_mesh_is_refused_by_name(rigs: dict) -> None:
    assert "bone 'left_knee'" in rigs["refused"]["no deform"] and "deforms no meshes" in rigs["refused"]["no deform"]
    assert "mirrored" in rigs["refused"]["mirrored"] and "zero scale" in rigs["refused"]["flat"]
    assert rigs["refused"]["meshes"] == 0


def test_objects_stand_in_the_frames_of_what_moves_them(rigs: dict) -> None:
    assert rigs["objects"]["scaled"] < 1e-5 and rigs["objects"]["alone"] < 1e-5
    assert rigs["objects"]["moved"] == pytest.approx(1.0, abs=1e-4)
    assert rigs["objects"]["modifiers"] == 0


def test_nothing_is_left_behind_and_modes_stay(scene: dict) -> None:
    case = scene["made_and_removed"]
    assert (case["poll before"], case["poll"]) == (False, True)
    counts = {"objects": 2, "meshes": 2, "materials": 2, "collections": 1, "armatures": 0, "scenes": 0,
              "node_groups": 0}  # fmt: skip
    assert case["renewed"] == counts
    assert case["figure"] == counts | {"objects": 3, "armatures": 1}
    assert case["mode"] == ["POSE", True]
    assert case["captured"] == 0  # a capture of the character leaves its stand-in out
    assert case["collections"] == [["CHONA Stand-Ins"]] * 2 and case["selectable"] == [True, True]
    assert not any(case["left"].values()) and not any(case["gone"].values()), case


def test_making_it_again_keeps_what_the_user_has_set(scene: dict) -> None:
    case = scene["renewed"]
    assert case["same"] == [True, True] and case["name"] == "My Name" and case["materials"] == ["own"]
    assert case["modifiers"] == ["CHONA Armature", "Smooth"]
    assert (case["camera"], case["render"], case["shadow"]) == (False, False, False)
    assert case["display"] == "BOUNDS" and case["hidden"] is True
    assert case["new"] > 0.01 and (case["meshes"], case["parts"], case["colours"]) == (2, 2, ["Color"])


def test_colours_reach_viewport_and_material(scene: dict) -> None:
    case = scene["shown"]
    assert case["error"] < 1e-6 and case["valid"] and case["smooth"]
    assert case["active"] == case["attribute"] == "Color" and case["render"] == 0
    np.testing.assert_allclose(case["viewport"], case["linear"], atol=1e-4)


def test_one_step_back_undoes_it(scene: dict) -> None:
    assert scene["undone"] == {"made": 2, "undone": [0, 0], "redone": [2, 2], "removed": 0, "back": 2}


def test_every_actor_has_its_own(scene: dict) -> None:
    assert scene["several"] == {"meshes": 4, "deleted": 1, "again": 2, "unlinked": 1, "linked": True, "removed": 2,
                                "kept": 2}  # fmt: skip


def test_what_a_cycles_render_sees(scene: dict) -> None:
    case = scene["rendered"]
    floor = case["VIEWPORT"]["open"]
    assert case["VIEWPORT"]["darkest"] == pytest.approx(floor, rel=0.02)
    # The camera sees the floor through it, and its shadow beside it.
    assert case["SHADOW"]["middle"][1] == pytest.approx(floor, rel=0.02) and case["SHADOW"]["middle"][3] == 1.0
    assert case["SHADOW"]["darkest"] < 0.05 * floor
    assert case["SHADOW"]["darkest right"] == pytest.approx(floor, rel=0.02)
    assert case["HOLDOUT"]["middle"] == [0.0, 0.0, 0.0, 0.0]
    red, _, blue, alpha = case["VISIBLE"]["middle"]
    assert alpha == 1.0 and blue > 5.0 * red > 0.0


def test_damaged_files_are_refused(scene: dict) -> None:
    words = {
        "version": "version 2", "format": "'other'", "count": "[3, 3]", "no parts": "TypeError",
        "faces": "vertices that are not there", "bone": "beyond the skeleton's 24", "sum": "do not sum to one",
        "nan": "not finite", "type": "float64", "cut": "zip", "none": "No such file",
    }  # fmt: skip
    assert scene["refused"].keys() == words.keys()
    for name, said in scene["refused"].items():
        assert words[name] in said and ("again" in said), (name, said)


def test_the_button_says_why_it_is_off(scene: dict) -> None:
    assert scene["polls"] == {"no model": "Choose a model file first", "fine": "", "joints": 24,
                              "no rig": "Create a rig, or choose an armature, first"}  # fmt: skip


@pytest.mark.parametrize("python", bpy_pythons()[:1])
def test_through_the_worker_against_the_models_own_skinning(python: str, tmp_path: Path) -> None:
    """Vertices of the posed mesh against where the model's kernels put the same canonical points."""
    needs_worker(python)
    import torch
    from tiny_models import trained

    from chona_model.data.dataset import Pose
    from chona_model.model_store import save_actor
    from chona_model.progress import Progress
    from chona_model.standin.grid_part import interpolate
    from chona_model.standin.make import StandInSettings, make_stand_in

    actor = trained()[1].actor()
    model = tmp_path / "model.safetensors"
    save_actor(model, actor, "chona", {}, {})
    answer = run_bpy(python, "stand_in_worker.py", model, sys.executable, tmp_path)
    assert answer["code"] == 0 and answer["camera"] is False and answer["operator"] == ["FINISHED"]
    assert 0 < answer["coarser"] < answer["vertices"] and answer["kept"] is True
    assert answer["wrong"] == 2 and answer["cancelled"] == ["CANCELLED", False]
    assert "changed while its stand-in was made" in answer["changed"]
    assert (answer["removed"], answer["left"]) == (0, 0) and (tmp_path / "saved.blend").is_file()

    make_stand_in(model, "Sub01", ("box01",), tmp_path / "again.npz", StandInSettings(0.03), Progress())
    with np.load(tmp_path / "again.npz") as made, np.load(tmp_path / "posed.npz") as posed:
        canonical, found, bones = made["part.0.vertices"], posed["found"], posed["world_from_bone"]
        kept = np.zeros((len(canonical), bones.shape[0]))
        for index, weights in zip(made["part.0.bones"].T, made["part.0.weights"].T, strict=True):
            kept[np.flatnonzero(index >= 0), index[index >= 0]] = weights[index >= 0]
    figure = actor.model.posed(Pose("Sub01", (), bones, np.zeros((0, 4, 4))))
    turn, shift = figure.figure.root_from_world[:3, :3], figure.figure.root_from_world[:3, 3]

    def away(offset: bool) -> np.ndarray:
        """[V] metres between the mesh and the model's skinning."""
        with torch.no_grad():
            matrices = actor.model.rendering_matrices(figure, offset).numpy()
        wanted = (actor.model.warp_points(figure, canonical, matrices) - shift) @ turn
        return np.linalg.norm(found - wanted, axis=1)

    # Weights below a hundredth are left out: how far that may carry is the way between the bones' own answers.
    volume = actor.model.volume(0)
    learned = interpolate(volume.grid, volume.weights().detach().numpy(), canonical.astype(float))
    rigid = bones[:, :3, :3] @ (canonical[:, None, :, None] - actor.persons["Sub01"].rest_joints[:, :, None])
    answers = rigid[..., 0] + bones[:, :3, 3]
    spread = np.linalg.norm(answers[:, :, None] - answers[:, None], axis=3).max(axis=(1, 2))
    assert (away(offset=False) <= 0.5 * np.abs(kept - learned).sum(axis=1) * spread + 1e-4).all()
    assert away(offset=False).mean() < 1e-3
    # The offset of this pose, which a mesh does not have.
    assert away(offset=True).max() < 1e-2

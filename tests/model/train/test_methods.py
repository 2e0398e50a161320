"""The compared systems: what each is told of objects, and that the command line names them all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_capture import tiny_capture
from tiny_models import tiny_trainer

from chona_model import command_line
from chona_model.data.dataset import Dataset, Pose
from chona_model.data.images import load_pixels
from chona_model.evaluate.run import evaluate
from chona_model.figure import Rig, make_figure
from chona_model.methods import METHODS, method_of
from chona_model.model_store import load_actor, save_actor
from chona_model.progress import Progress
from chona_model.settings import RENDER_PRESETS
from chona_model.train.exact_trainer import ExactTrainer, PaperSettings
from chona_model.train.run import TrainRun, train


@pytest.fixture
def capture(tmp_path: Path) -> Dataset:
    return tiny_capture(tmp_path, frames=2, cameras=2)


def turned(pose: Pose) -> Pose:
    """The same pose with its objects turned where they are."""
    world_from_object = pose.world_from_object.copy()
    world_from_object[:, :3, :3] = (
        Rotation.random(len(pose.objects), random_state=5).as_matrix() @ world_from_object[:, :3, :3]
    )
    return replace(pose, world_from_object=world_from_object)


def test_the_command_line_names_every_method() -> None:
    assert tuple(METHODS) == command_line.METHODS
    with pytest.raises(ValueError, match="the model's method is 'later', this version has chona"):
        method_of("later")


def test_objects_that_are_placed_move_and_keep_the_worlds_axes(capture: Dataset) -> None:
    pose = capture.views[0].pose
    joints = next(iter(capture.persons.values())).rest_joints
    bones = len(capture.skeleton)
    told, untold = (
        make_figure(Rig(capture.skeleton, joints, 1.0, turns), pose.world_from_bone, turned(pose).world_from_object, 1)
        for turns in (True, False)
    )
    world_from_object = (
        np.linalg.inv(untold.root_from_world) @ untold.transforms[bones] @ _canonical_object(capture, joints)
    )
    assert np.allclose(world_from_object[:3, :3], np.eye(3), atol=1e-12)
    assert np.allclose(world_from_object[:3, 3], pose.world_from_object[0, :3, 3], atol=1e-12)
    assert not np.allclose(told.transforms[bones], untold.transforms[bones], atol=0.1)
    assert np.array_equal(told.transforms[:bones], untold.transforms[:bones])


def _canonical_object(capture: Dataset, joints: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = Rig(capture.skeleton, joints, 1.0).canonical_objects(1)[0]
    return matrix


@pytest.mark.parametrize("name", ["object-translation", "chona"])
def test_a_model_of_placed_objects_draws_them_alike_however_they_are_turned(
    capture: Dataset, tmp_path: Path, name: str
) -> None:
    """Through the file: a shot of such a model must look as its training did."""
    trainer = tiny_trainer(capture, method=METHODS[name])
    for index in range(20):
        trainer.step(index, index / 20)
    path = tmp_path / "model.safetensors"
    save_actor(path, trainer.actor(), name, {}, {})
    actor, view = load_actor(path), capture.views[0]
    one, other = (
        actor.render(pose, view.camera, RENDER_PRESETS["draft"]).rgb for pose in (view.pose, turned(view.pose))
    )
    assert np.array_equal(one, other) == (name == "object-translation")


def test_boxes_of_placed_objects_hold_them_turned_anyhow(capture: Dataset) -> None:
    (before,), (after,) = (each.objects.values() for each in (capture, METHODS["object-translation"].dataset(capture)))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    corners = before.lower + corners * (before.upper - before.lower)
    everywhere = np.einsum("rij,kj->rki", Rotation.random(200, random_state=2).as_matrix(), corners)
    assert (everywhere >= after.lower - 1e-12).all() and (everywhere <= after.upper + 1e-12).all()


def test_without_pseudo_bone_the_object_is_the_persons(capture: Dataset) -> None:
    seen = METHODS["tava"].dataset(capture)
    assert not seen.objects and not seen.views[0].pose.objects
    before, after = load_pixels(capture.views[0]), load_pixels(seen.views[0])
    assert before.object.any() and not after.object.any()
    assert np.array_equal(after.person, before.mask) and np.array_equal(after.rgb, before.rgb)
    trainer = tiny_trainer(capture, method=METHODS["tava"])
    held = trainer.model.occupancy.centres(0, trainer.model.occupancy.occupied(0))
    joints = next(iter(capture.persons.values())).rest_joints
    assert np.linalg.norm(held[:, None] - joints, axis=-1).min(axis=1).max() > 0.25  # the body alone reaches 0.12


def test_objects_alone_are_nothing_to_a_method_without_them(tmp_path: Path) -> None:
    alone = tiny_capture(tmp_path, persons=0)
    assert METHODS["tava"].dataset(alone).views == ()


def test_the_paths_agree_on_what_a_method_is(capture: Dataset) -> None:
    small = replace(PaperSettings(), initial_steps=1, rays=16)
    for method in (each for each in METHODS.values() if not each.distances):
        exact = ExactTrainer(capture, small, 0, method=method)
        fast = tiny_trainer(capture, method=method)
        assert exact.actor().model.shape.turns_objects == fast.model.shape.turns_objects == (method.objects != "placed")
        assert exact.actor().model.shape.reach == fast.model.shape.reach == method.reach
        assert list(exact.actor().objects) == [thing.name for thing in fast.model.objects]


@pytest.mark.parametrize("name", ["tava", "object-translation", "arah-object"])
def test_methods_are_trained_and_evaluated_by_their_name(capture: Dataset, tmp_path: Path, name: str) -> None:
    model = train(capture, tmp_path / "run", TrainRun(method=name, steps=3), Progress())
    report = evaluate(model, capture, "draft", 0.5, None, tmp_path / "report.json", Progress())
    assert len(report["images"]) == len(capture.views)
    assert np.isfinite(report["mean"]["psnr"])

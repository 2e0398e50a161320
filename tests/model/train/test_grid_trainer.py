"""Training of grid models: it learns, repeats, resumes, and separates identities."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tiny_capture import tiny_capture
from tiny_models import SETTINGS, SHAPE, tiny_trainer, trained

from chona_model.data.dataset import DatasetError
from chona_model.data.images import load_pixels
from chona_model.evaluate.metrics import psnr
from chona_model.settings import RENDER_PRESETS
from chona_model.train import grid_trainer
from chona_model.train.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from chona_model.train.grid_trainer import GridTrainer, _wrong_part
from chona_model.train.ray_codes import ray_codes


def test_learns_what_the_pictures_show() -> None:
    dataset, trainer = trained()
    actor = trainer.actor()
    scores, empty = [], []
    for view in dataset.views[::3]:
        pixels = load_pixels(view)
        picture = actor.render(view.pose, view.camera, RENDER_PRESETS["final"])
        scores.append(psnr(np.clip(picture.rgb, 0, 1), pixels.rgb))
        empty.append(psnr(np.zeros_like(pixels.rgb), pixels.rgb))
    assert np.mean(scores) > np.mean(empty) + 8.0
    assert np.mean(scores) > 19.0


def test_mattes_follow_the_masks() -> None:
    dataset, trainer = trained()
    view = dataset.views[0]
    pixels = load_pixels(view)
    picture = trainer.actor().render(view.pose, view.camera, RENDER_PRESETS["final"])
    assert picture.human[pixels.person].mean() > 0.8
    assert picture.object[pixels.object].mean() > 0.8
    assert picture.human[pixels.object].mean() < 0.2
    assert picture.alpha[~pixels.mask].mean() < 0.05


@pytest.fixture
def capture(tmp_path):
    return tiny_capture(tmp_path, persons=2, objects=2, frames=2, cameras=2, size=(32, 24))


@pytest.mark.parametrize("stop", [37, 55])
def test_the_same_seed_gives_the_same_model_and_resuming_changes_nothing(capture, tmp_path, stop: int) -> None:
    """``stop`` lies before and after the posed grids were made anew."""
    whole, broken = tiny_trainer(capture), tiny_trainer(capture)
    for index in range(60):
        whole.step(index, index / 60)
    for index in range(stop):
        broken.step(index, index / 60)
    settings = {"preset": "fast", "seed": 0}
    save_checkpoint(tmp_path, broken.state(), {"step": stop, "seconds": 1.0}, settings)
    state, position = load_checkpoint(tmp_path, settings)
    resumed = tiny_trainer(capture)
    resumed.restore(state, position.step)
    for index in range(position.step, 60):
        resumed.step(index, index / 60)
    expected, got = whole.state(), resumed.state()
    assert expected.keys() == got.keys()
    for name, value in expected.items():
        assert torch.equal(value, got[name]), name


def test_a_checkpoint_of_other_settings_is_refused(capture, tmp_path) -> None:
    trainer = tiny_trainer(capture)
    save_checkpoint(tmp_path, trainer.state(), {"step": 1, "seconds": 1.0}, {"preset": "fast", "seed": 0})
    with pytest.raises(CheckpointError, match="seed was 0, is 1"):
        load_checkpoint(tmp_path, {"preset": "fast", "seed": 1})
    with pytest.raises(CheckpointError, match="cannot continue"):
        load_checkpoint(tmp_path / "elsewhere", {})


def test_invariant_learning_exchanges_the_code_that_a_ray_does_not_show(capture) -> None:
    trainer = tiny_trainer(capture)
    pose = np.zeros(300, dtype=np.int32)
    part = np.repeat([0, 1, 2], 100)
    figure = trainer.posed[0]
    pairs, index = ray_codes(trainer.model, trainer.posed, pose, part, exchange=True, seed=0, step=5)
    assert (index[:, 0] == index[:, 1]).all()
    drawn = pairs[index[:, 1]]
    own = torch.tensor([figure.person, figure.objects[0]])
    exchanged = drawn[:100] != own  # the background is taken for either by lot
    assert exchanged.any(dim=0).all() and not exchanged.all(dim=1).any()
    assert (drawn[100:200, 0] == figure.person).all()
    assert set(drawn[100:200, 1].tolist()) == {0, 1}
    assert (drawn[200:, 1] == figure.objects[0]).all()
    assert set(drawn[200:, 0].tolist()) == {0, 1}
    pairs, index = ray_codes(trainer.model, trainer.posed, pose, part, exchange=False, seed=0, step=5)
    assert (pairs[index[:, 0]] == torch.tensor([figure.person, figure.objects[0]])).all()


def test_matrices_that_were_let_go_are_made_again(tmp_path, monkeypatch) -> None:
    dataset = tiny_capture(tmp_path, persons=1, objects=1, frames=5, cameras=2, size=(32, 24))
    states = []
    for kept in (64, SETTINGS.poses):
        monkeypatch.setattr(grid_trainer, "KEPT_MATRICES", kept)
        trainer = tiny_trainer(dataset)
        assert len(trainer.posed) > SETTINGS.poses
        for index in range(12):  # before any learning of skinning, which forgets them all
            trainer.step(index, 0.0)
        assert len(trainer._kept) == min(kept, len(trainer.posed))
        states.append(trainer.state())
    assert all(torch.equal(value, states[1][name]) for name, value in states[0].items())


def test_masks_without_a_hull_are_refused(tmp_path) -> None:
    dataset = tiny_capture(tmp_path)
    for view in dataset.views:
        Image.fromarray(np.zeros((24, 32), dtype=np.uint8)).save(view.person_mask)
    with pytest.raises(DatasetError, match="no room for Sub01"):
        tiny_trainer(dataset)


def test_opacity_on_the_wrong_part_costs() -> None:
    """Columns: colour, alpha, depth, opacity on objects. Rays of neither part cost nothing here."""
    out = torch.tensor([[0, 0, 0, 0.9, 0, 0.3], [0, 0, 0, 0.9, 0, 0.3], [0, 0, 0, 0.9, 0, 0.3]], dtype=torch.float32)
    wrong = _wrong_part(out, torch.tensor([0, 1, 2], dtype=torch.int8))
    torch.testing.assert_close(wrong, torch.tensor([0.0, 0.3**2, 0.6**2]))


def test_the_stages_train_as_the_kernels_do(tmp_path: Path) -> None:
    """What a GPU runs, on the CPU in float64: the same losses step by step while rounding has not told on them yet."""
    dataset = tiny_capture(tmp_path, frames=3, cameras=4, size=(64, 48))
    fused, staged = (
        GridTrainer(dataset, SETTINGS, 0, shape=SHAPE, dtype=dtype) for dtype in (torch.float32, torch.float64)
    )
    assert fused.fused
    assert not staged.fused
    losses = [[trainer.step(index, index / 60)["loss"] for index in range(60)] for trainer in (fused, staged)]
    np.testing.assert_allclose(losses[1][:5], losses[0][:5], rtol=0.02)
    assert np.mean(losses[1][-10:]) < 0.85 * losses[1][0]
    assert np.mean(losses[1][-10:]) == pytest.approx(np.mean(losses[0][-10:]), rel=0.3)


def test_stages_resume_where_they_were(tmp_path: Path) -> None:
    dataset = tiny_capture(tmp_path, frames=2, cameras=3)
    whole, first, second = (GridTrainer(dataset, SETTINGS, 0, shape=SHAPE, dtype=torch.float64) for _ in range(3))
    for index in range(12):
        loss = whole.step(index, index / 40)["loss"]
    for index in range(8):
        first.step(index, index / 40)
    second.restore(first.state(), 8)
    for index in range(8, 12):
        again = second.step(index, index / 40)["loss"]
    assert again == loss


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no graphics card with CUDA")
def test_training_on_a_graphics_card(tmp_path: Path) -> None:
    dataset = tiny_capture(tmp_path, frames=3, cameras=4, size=(64, 48))
    fused, card = (GridTrainer(dataset, SETTINGS, 0, shape=SHAPE, device=device) for device in ("cpu", "cuda"))
    losses = [[trainer.step(index, index / 60)["loss"] for index in range(60)] for trainer in (fused, card)]
    assert np.mean(losses[1][-10:]) == pytest.approx(np.mean(losses[0][-10:]), rel=0.3)

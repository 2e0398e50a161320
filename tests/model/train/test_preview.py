"""Pictures of a training that goes on, and the file that stops one: neither changes the model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from safetensors.torch import load_file
from tiny_capture import tiny_capture
from tiny_runs import fast_trainer, paper_trainer, train

from chona_model.data.dataset import Dataset
from chona_model.data.images import load_pixels
from chona_model.formats.model_file import read_header
from chona_model.settings import RENDER_PRESETS
from chona_model.train.grid_trainer import GridTrainer
from chona_model.train.preview import LARGEST_SHARE, NAME, SIDE, Preview
from chona_model.train.run import STOP, TrainRun


class Clock:
    """Time that moves when told to, and by ``cost`` with every look at it."""

    def __init__(self, cost: float = 0.0) -> None:
        self.now, self.cost = 0.0, cost

    def __call__(self) -> float:
        self.now += self.cost
        return self.now


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return tiny_capture(tmp_path_factory.mktemp("capture"), frames=2, cameras=2)


def same(one: Path, other: Path) -> bool:
    """Whether two model files hold the same tensors, bit for bit."""
    first, second = load_file(one), load_file(other)
    return first.keys() == second.keys() and all(
        first[name].numpy().tobytes() == second[name].numpy().tobytes() for name in first
    )


@pytest.mark.parametrize(("preset", "steps"), [("fast", 52), ("paper", 3)])
def test_previews_change_no_bit_of_the_model(capture, tmp_path, monkeypatch, preset: str, steps: int) -> None:
    """``fast``: past the first refresh of the occupancy and the first rebuild of the posed grids."""
    monkeypatch.setattr("chona_model.train.preview.LARGEST_SHARE", 1.0)
    plain, drawn = (
        train(monkeypatch, capture, tmp_path / name, preset=preset, steps=steps, preview_every=every)
        for name, every in (("plain", None), ("drawn", 1e-6))
    )
    assert same(plain, drawn)
    assert not (tmp_path / "plain" / NAME).exists() and (tmp_path / "drawn" / NAME).is_file()
    lines = [json.loads(line) for line in (tmp_path / "drawn" / "log.jsonl").read_text("utf-8").splitlines()]
    assert len([line for line in lines if line.get("preview_psnr", 0.0) > 5.0]) >= steps // 2
    assert not [name for name in (tmp_path / "drawn").iterdir() if name.name.startswith(".")]


def test_the_picture_is_the_truth_beside_the_model(capture, tmp_path) -> None:
    trainer = fast_trainer(capture, TrainRun())
    preview = Preview(capture, tmp_path, 1.0)
    psnr = preview.draw(trainer.actor())
    picture = np.asarray(Image.open(tmp_path / NAME)).astype(float) / 255.0
    height, width = picture.shape[0], picture.shape[1] // 2
    assert max(height, width) <= SIDE
    left, right = picture[:, :width], picture[:, width:]
    masks = [load_pixels(view) for view in capture.views]
    shown = max(range(len(masks)), key=lambda index: masks[index].mask.mean())
    truth, view = masks[shown], capture.views[shown]
    filled = [np.flatnonzero(truth.mask.any(axis)) for axis in (1, 0)]
    assert height > filled[0][-1] - filled[0][0] and width > filled[1][-1] - filled[1][0], "all of the figure"
    assert (left > 0).any(axis=-1).sum() == (np.round(truth.rgb * 255) > 0).any(axis=-1).sum()
    places = np.argwhere((np.round(truth.rgb * 255) > 0).any(axis=-1))
    row, column = places.min(axis=0) - np.argwhere((left > 0).any(axis=-1)).min(axis=0)
    part = slice(row, row + height), slice(column, column + width)
    assert np.abs(left - truth.rgb[part]).max() < 0.003
    whole = trainer.actor().render(view.pose, view.camera, RENDER_PRESETS["preview"])
    model = np.clip(whole.rgb, 0, 1)[part]
    assert np.abs(right - model).max() < 0.003
    assert psnr == pytest.approx(-10 * np.log10(((model - truth.rgb[part]) ** 2).mean()), abs=0.01)


def test_previews_take_no_more_than_their_share(capture, tmp_path) -> None:
    actor = fast_trainer(capture, TrainRun()).actor()
    clock = Clock()
    preview = Preview(capture, tmp_path, 5.0, clock)
    assert preview.due(), "the first comes at once"
    preview.draw(actor)
    clock.now = 4.9
    assert not preview.due()
    clock.now = 5.1
    assert preview.due()
    slow = Clock(cost=3.0)
    preview = Preview(capture, tmp_path, 5.0, slow)
    preview.draw(actor)  # takes three seconds by this clock
    drawn_at, slow.cost = slow.now, 0.0
    slow.now = drawn_at + 3.0 * (1.0 / LARGEST_SHARE - 1.0) - 0.1
    assert not preview.due()
    slow.now += 0.2
    assert preview.due()


def test_large_images_are_shrunk(capture, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("chona_model.train.preview.SIDE", 12)
    Preview(capture, tmp_path, 1.0).draw(fast_trainer(capture, TrainRun()).actor())
    with Image.open(tmp_path / NAME) as picture:
        assert 10 <= max(picture.height, picture.width // 2) <= 12


@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_the_file_stop_pauses_without_losing_a_step(capture, tmp_path, monkeypatch, preset: str) -> None:
    make = fast_trainer if preset == "fast" else paper_trainer
    stop_at, steps = 3, 6

    def stopping(dataset: Dataset, run: TrainRun) -> GridTrainer:
        trainer = make(dataset, run)
        step = trainer.step

        def stepped(index: int, share: float) -> dict[str, float]:
            if index + 1 == stop_at:
                (tmp_path / "paused" / STOP).touch()
            return step(index, share)

        monkeypatch.setattr(trainer, "step", stepped)
        return trainer

    whole = train(monkeypatch, capture, tmp_path / "whole", make, preset=preset, steps=steps)
    (tmp_path / "paused").mkdir()
    (tmp_path / "paused" / STOP).touch()  # left behind by a program that was killed
    paused = train(monkeypatch, capture, tmp_path / "paused", stopping, preset=preset, steps=steps)
    assert not (tmp_path / "paused" / STOP).exists() and not same(whole, paused)
    assert read_header(paused).training["steps"] == stop_at
    train(monkeypatch, capture, tmp_path / "paused", make, preset=preset, steps=steps, resume=True)
    assert same(whole, paused)

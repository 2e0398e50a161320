"""Extremes of rates: 200 steps at a hundred times the rates end in words, or in a model that shows something."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from tiny_capture import tiny_capture
from tiny_runs import RATES, fast_trainer, paper_trainer, train

from chona_model.data.dataset import Dataset
from chona_model.data.images import load_pixels
from chona_model.model_store import load_actor
from chona_model.settings import RENDER_PRESETS
from chona_model.train.errors import TrainingError

STEPS = 200


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Dataset:
    return tiny_capture(tmp_path_factory.mktemp("capture"), persons=1, objects=1, frames=2, cameras=3)


def ends_well(patch, capture: Dataset, out: Path, make, *, lost: bool | None = None, steps: int = STEPS) -> None:
    """Trains: either words and no model, or a model that shows more than nothing; ``lost`` says which where known."""
    try:
        path = train(patch, capture, out, make, steps=steps)
    except TrainingError as error:
        assert lost is not False, error
        assert "step" in str(error) and "_rate" in str(error) and "check-data" in str(error)
        assert "no checkpoint was written, and no model" in str(error)
        assert [file.name for file in out.iterdir()] == ["log.jsonl"]
        return
    assert not lost
    actor, errors, empty = load_actor(path), [], []
    assert all(torch.isfinite(tensor).all() for tensor in actor.tensors().values() if tensor.is_floating_point())
    for view in capture.views[:2]:
        pixels = load_pixels(view)
        picture = actor.render(view.pose, view.camera, RENDER_PRESETS["draft"])
        assert np.isfinite(picture.rgb).all()
        errors.append(((picture.rgb - pixels.rgb) ** 2).mean())
        empty.append((pixels.rgb**2).mean())
    assert np.mean(errors) < np.mean(empty), "a model that shows no more than nothing was written without a word"


@pytest.mark.parametrize(
    ("rates", "lost"),
    [
        (RATES, None),
        *[pytest.param((name,), lost, marks=pytest.mark.slow) for name, lost in (
            ("grid_rate", None), ("mlp_rate", None), ("light_rate", None), ("skin_rate", False),
            ("offset_rate", False))],
    ],
)  # fmt: skip
def test_fast_at_a_hundred_times_the_rates(capture, monkeypatch, tmp_path, rates: tuple[str, ...], lost) -> None:
    factors = dict.fromkeys(rates, 100.0)
    ends_well(monkeypatch, capture, tmp_path, lambda d, run: fast_trainer(d, run, **factors), lost=lost)


def test_fast_at_a_thousand_times_the_rates(capture, monkeypatch, tmp_path) -> None:
    factors = dict.fromkeys(RATES, 1000.0)
    ends_well(monkeypatch, capture, tmp_path, lambda d, run: fast_trainer(d, run, **factors), lost=True)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 100.0])
def test_the_stages_at_a_hundred_times_the_rates(capture, monkeypatch, tmp_path, factor: float) -> None:
    def make(dataset, run):
        return fast_trainer(dataset, run, torch.float64, **dict.fromkeys(RATES, factor))

    ends_well(monkeypatch, capture, tmp_path, make, lost=None if factor > 1 else False)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 100.0, 10_000.0])
def test_paper_at_a_hundred_times_the_rate(capture, monkeypatch, tmp_path, factor: float) -> None:
    def make(dataset, run):
        return paper_trainer(dataset, run, factor)

    ends_well(monkeypatch, capture, tmp_path, make, lost=None if factor > 1 else False)


def test_paper_at_a_million_times_the_rate(capture, monkeypatch, tmp_path) -> None:
    """So high that the first steps decide; 32 steps of nothing are enough at the end."""
    ends_well(monkeypatch, capture, tmp_path, lambda d, run: paper_trainer(d, run, 1e6), steps=64, lost=True)

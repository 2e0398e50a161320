"""Several sets trained together: each image gives its set's share of rays; people and objects of all are learned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_capture import tiny_capture
from tiny_models import SETTINGS, tiny_trainer

from chona_model.data.dataset import Dataset
from chona_model.data.images import load_pixels
from chona_model.data.opener import join_datasets
from chona_model.data.renamed import renamed
from chona_model.evaluate.metrics import psnr
from chona_model.settings import RENDER_PRESETS
from chona_model.train.exact_trainer import ExactTrainer, PaperSettings


def shared(folder: Path, prefix: str, share: float, **kind: int) -> Dataset:
    """A tiny capture with names of its own, whose images draw ``share`` of the rays."""
    dataset = tiny_capture(folder, **kind)
    dataset = renamed(dataset, {name: prefix + name for name in (*dataset.persons, *dataset.objects)})
    views = tuple(replace(view, sequence=prefix + view.sequence, ray_share=share) for view in dataset.views)
    return replace(dataset, views=views)


@pytest.fixture
def joint(tmp_path: Path) -> Dataset:
    """People with objects, a person alone, and an object alone."""
    return join_datasets(
        [
            shared(tmp_path / "a", "both-", 1.0),
            shared(tmp_path / "b", "person-", 0.5, objects=0),
            shared(tmp_path / "c", "object-", 0.25, persons=0),
        ]
    )


def test_an_image_gives_its_sets_share_of_rays(joint: Dataset) -> None:
    trainer = tiny_trainer(joint)
    counts = {}
    for pose, group in enumerate(trainer.groups):
        drawn = trainer._draw(pose, SETTINGS.rays, np.random.default_rng(0))
        counts[group.views[0].sequence.split("-")[0]] = len(drawn)
    assert counts == {"both": SETTINGS.rays, "person": SETTINGS.rays // 2, "object": SETTINGS.rays // 4}


def test_the_paper_path_gives_the_same_shares(joint: Dataset) -> None:
    trainer = ExactTrainer(joint, replace(PaperSettings(), initial_steps=1), 0)
    assert sorted({image.ray_share for image in trainer.images}) == [0.25, 0.5, 1.0]
    assert trainer.rays == 2048.0


def test_one_model_learns_them_all(joint: Dataset) -> None:
    trainer = tiny_trainer(joint)
    assert {person.name for person in trainer.model.persons} == {"both-Sub01", "person-Sub01"}
    assert {thing.name for thing in trainer.model.objects} == {"both-box01", "object-box01"}
    for index in range(200):
        trainer.step(index, index / 200)
    actor = trainer.actor()
    for prefix in ("both", "person", "object"):
        view = next(view for view in joint.views if view.sequence.startswith(prefix))
        target = load_pixels(view).rgb
        predicted = np.clip(actor.render(view.pose, view.camera, RENDER_PRESETS["final"]).rgb, 0.0, 1.0)
        assert psnr(predicted, target) > psnr(np.zeros_like(target), target) + 3.0, prefix

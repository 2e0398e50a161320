"""How a field keeps identities apart: by tables and codes, by codes alone (joint), or each part by its own code."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny_capture import tiny_capture
from tiny_models import tiny_trainer

from chona_model.data.dataset import Dataset
from chona_model.data.images import load_pixels
from chona_model.evaluate.metrics import psnr
from chona_model.grid_actor import GridActor
from chona_model.grid_model import GridModel
from chona_model.methods import METHODS
from chona_model.model_store import load_actor, save_actor
from chona_model.settings import RENDER_PRESETS
from chona_model.train.grid_trainer import GridTrainer

FINAL = RENDER_PRESETS["final"]
STEPS = 250


@pytest.fixture(scope="module")
def joint(tmp_path_factory: pytest.TempPathFactory) -> GridTrainer:
    folder = tmp_path_factory.mktemp("joint")
    dataset = tiny_capture(folder, persons=2, objects=2, frames=3, cameras=4, size=(64, 48))
    trainer = tiny_trainer(dataset, method=METHODS["joint"])
    trainer.views = dataset.views  # type: ignore[attr-defined]
    for index in range(STEPS):
        trainer.step(index, index / STEPS)
    return trainer


def test_persons_share_a_table_and_objects_another(joint: GridTrainer) -> None:
    field = joint.model.field
    assert field.table.shape[0] == 2
    assert field.table_of.tolist() == [0, 0, 1, 1]
    lower = joint.model.boxes[0]
    assert np.allclose(field.lower.numpy(), [lower[:2].min(axis=0), lower[2:].min(axis=0)], atol=1e-6)


def test_it_learns_them_all(joint: GridTrainer) -> None:
    actor = GridActor(joint.model)
    for view in joint.views[:: len(joint.views) // 4]:  # type: ignore[attr-defined]
        target = load_pixels(view).rgb
        picture = np.clip(actor.render(view.pose, view.camera, FINAL).rgb, 0.0, 1.0)
        assert psnr(picture, target) > psnr(np.zeros_like(target), target) + 6.0, view.label


def test_codes_alone_tell_persons_apart(joint: GridTrainer) -> None:
    field = joint.model.field
    points = torch.tensor([[0.0, 0.2, 0.0], [0.05, 0.4, 0.02]])
    of = torch.zeros(2, dtype=torch.int64)

    def raw(part: int, pair: list[int]) -> torch.Tensor:
        return field.raw_density(points, torch.full((2,), part, dtype=torch.int32), torch.tensor([pair]), of)

    assert raw(0, [0, -1]).equal(raw(1, [0, -1]))
    assert not raw(0, [0, -1]).equal(raw(0, [1, -1]))


def test_the_kernels_and_the_stages_of_tensors_agree(joint: GridTrainer) -> None:
    view = joint.views[0]  # type: ignore[attr-defined]
    settings = replace(FINAL, supersampling=1, newton_steps=12, stop=0.0, tolerance=1e-6)
    fast = GridActor(joint.model).render(view.pose, view.camera, settings)
    exact = GridActor(joint.model)._in("float64").render(view.pose, view.camera, settings)
    # A ray may gain or lose a sample that falls within rounding of an occupancy cell's border.
    assert np.quantile(np.abs(fast.rgb - exact.rgb)[fast.alpha > 0.01], 0.98) < 1e-3
    assert (fast.alpha > 0.5).sum() > 100


@pytest.mark.parametrize(("persons", "objects"), [(["Sub02"], ["box01"]), (["Sub02"], []), ([], ["box02"])])
def test_a_part_of_the_file_renders_as_the_whole(
    joint: GridTrainer, tmp_path: Path, persons: list[str], objects: list[str]
) -> None:
    path = tmp_path / "model.safetensors"
    save_actor(path, GridActor(joint.model), "joint", {}, {})
    whole, part = load_actor(path), load_actor(path, persons=persons, objects=objects)
    names = {*persons, *objects}
    views = [view for view in joint.views if names & {*view.pose.shown}]  # type: ignore[attr-defined]
    pose = views[0].pose
    pose = replace(
        pose, person=persons[0] if persons else None, objects=tuple(objects),
        world_from_object=pose.world_from_object[: len(objects)],
    )  # fmt: skip
    one, other = (actor.render(pose, views[0].camera, FINAL) for actor in (whole, part))
    assert one.rgb.tobytes() == other.rgb.tobytes()
    assert (one.alpha > 0.5).sum() > 20


def learned(folder: Path, method: str) -> tuple[Dataset, GridTrainer]:
    dataset = tiny_capture(folder, persons=2, objects=2, frames=3, cameras=4, size=(64, 48))
    trainer = tiny_trainer(dataset, method=METHODS[method])
    for index in range(STEPS):
        trainer.step(index, index / STEPS)
    return dataset, trainer


def with_codes_exchanged(model: GridModel, kind: str) -> GridActor:
    """The model where persons, or objects, have each other's codes; tables stay."""
    copy = deepcopy(model)
    codes = copy.field.person_codes if kind == "person" else copy.field.object_codes
    with torch.no_grad():
        codes.copy_(codes.flip(0))
    return GridActor(copy)


def change(dataset: Dataset, trainer: GridTrainer, kind: str) -> float:
    """Mean change of the pixels that do not show the kind whose codes are exchanged, over some views."""
    plain, exchanged = GridActor(trainer.model), with_codes_exchanged(trainer.model, kind)
    found = []
    for view in dataset.views[::5]:
        one, two = (actor.render(view.pose, view.camera, FINAL) for actor in (plain, exchanged))
        shows, others = ("human", "object") if kind == "object" else ("object", "human")
        still = (getattr(one, shows) > 0.95) & (getattr(one, others) == 0.0) & (getattr(two, others) == 0.0)
        assert still.sum() > 10
        found.append(np.abs(one.rgb - two.rgb)[still])
    return float(np.concatenate(found).mean())


@pytest.mark.parametrize("kind", ["person", "object"])
@pytest.mark.parametrize(
    ("with_it", "without", "bound"),
    [("chona", "no-cil", 0.02), pytest.param("joint", "joint-no-cil", 0.12, marks=pytest.mark.slow)],
)
def test_what_is_seen_of_one_hardly_depends_on_the_others_code(
    tmp_path_factory: pytest.TempPathFactory, with_it: str, without: str, bound: float, kind: str
) -> None:
    """Of CIL: a bound of the mean, and well below what it is without; with tables apart, or joint."""
    changes = [change(*_learned_once(tmp_path_factory, method), kind) for method in (with_it, without)]
    assert changes[0] < bound and changes[0] < 0.6 * changes[1]


@pytest.mark.parametrize("kind", ["person", "object"])
def test_own_codes_are_all_that_is_seen(tmp_path_factory: pytest.TempPathFactory, kind: str) -> None:
    assert change(*_learned_once(tmp_path_factory, "separate"), kind) == 0.0


_ONCE: dict[str, tuple[Dataset, GridTrainer]] = {}


def _learned_once(factory: pytest.TempPathFactory, method: str) -> tuple[Dataset, GridTrainer]:
    if method not in _ONCE:
        _ONCE[method] = learned(factory.mktemp(method), method)
    return _ONCE[method]

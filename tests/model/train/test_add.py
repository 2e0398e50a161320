"""``chona add``: a person or an object seen alone joins a model, whose others stay as they were to the bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file
from tiny_capture import tiny_capture, tiny_pose
from tiny_models import SETTINGS, trained

from chona_model.camera import Camera
from chona_model.data.dataset import Dataset, DatasetError, ObjectShape, Pose
from chona_model.data.images import load_pixels
from chona_model.data.renamed import renamed
from chona_model.evaluate.metrics import psnr
from chona_model.formats.model_file import ModelFileError, read_header
from chona_model.grid_growth import grown
from chona_model.model_store import load_actor, save_actor
from chona_model.progress import Progress
from chona_model.settings import RENDER_PRESETS
from chona_model.train.add import add
from chona_model.train.checkpoint import CheckpointError
from chona_model.train.run import TrainRun

STEPS = 150
FINAL = RENDER_PRESETS["final"]


def base_model(folder: Path, method: str = "chona", **kind: int) -> Path:
    """A trained model's file."""
    _, trainer = trained(**kind)
    path = folder / "base.safetensors"
    save_actor(path, trainer.actor(), method, {"preset": "fast"}, {"steps": 500, "poses_seen": None})
    return path


def alone(folder: Path, prefix: str = "new-", **kind: int) -> Dataset:
    """A capture of others, alone by default."""
    dataset = tiny_capture(folder, frames=3, cameras=4, size=(64, 48), **kind)
    return renamed(dataset, {name: prefix + name for name in (*dataset.persons, *dataset.objects)})


def added(base: Path, dataset: Dataset, names: list[str], out: Path, **run: object) -> Path:
    given = TrainRun(**({"steps": STEPS} | run))  # type: ignore[arg-type]
    return add(base, dataset, {name: name for name in names}, out, given, Progress(), SETTINGS)


def views_of(base: Path) -> tuple[list[Pose], Camera]:
    dataset, _ = trained()
    return [dataset.views[0].pose, dataset.views[4].pose], dataset.views[1].camera


@pytest.fixture(scope="module")
def person_added(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Dataset]:
    folder = tmp_path_factory.mktemp("add")
    base = base_model(folder)
    dataset = alone(folder / "data", objects=0)
    return base, added(base, dataset, ["new-Sub01"], folder / "run"), dataset


def test_the_others_are_the_same_to_the_bit(person_added: tuple[Path, Path, Dataset]) -> None:
    base, model, _ = person_added
    before, after = load_file(base), load_file(model)
    own = {name for name in after if name.startswith("person.new-Sub01.")} | {"codes.persons"}
    assert set(after) - set(before) == own - {"codes.persons"}
    for name, value in before.items():
        if name != "codes.persons":
            assert after[name].numpy().tobytes() == value.numpy().tobytes(), name
    assert after["codes.persons"][:1].equal(before["codes.persons"])
    old, new = load_actor(base), load_actor(model)
    poses, camera = views_of(base)
    for pose in poses:
        one, other = old.render(pose, camera, FINAL), new.render(pose, camera, FINAL)
        assert one.rgb.tobytes() == other.rgb.tobytes()
        assert one.depth.tobytes() == other.depth.tobytes()
        assert (one.alpha > 0.5).sum() > 50


def test_the_new_person_looks_like_its_capture(person_added: tuple[Path, Path, Dataset]) -> None:
    _, model, dataset = person_added
    actor = load_actor(model)
    for view in (dataset.views[0], dataset.views[6]):
        target = load_pixels(view).rgb
        picture = np.clip(actor.render(view.pose, view.camera, FINAL).rgb, 0.0, 1.0)
        assert psnr(picture, target) > psnr(np.zeros_like(target), target) + 8.0


def test_the_new_person_is_animated_with_the_old_object(person_added: tuple[Path, Path, Dataset]) -> None:
    _, model, dataset = person_added
    actor = load_actor(model)
    pose = replace(tiny_pose(dataset.persons["new-Sub01"], "box01", 1), person="new-Sub01")
    picture = actor.render(pose, dataset.views[0].camera, FINAL)
    alone_pose = replace(pose, objects=(), world_from_object=np.zeros((0, 4, 4)))
    without = actor.render(alone_pose, dataset.views[0].camera, FINAL)
    assert (picture.object > 0.5).sum() > 30
    person = picture.human > 0.9
    assert person.sum() > 50
    # What the person looks like does not come from the object's code.
    assert np.abs(picture.rgb - without.rgb)[person].mean() < 0.03


def test_the_file_says_what_was_added(person_added: tuple[Path, Path, Dataset]) -> None:
    header = read_header(person_added[1])
    (note,) = header.training["added"]
    assert note["identities"] == ["new-Sub01"]
    assert note["steps"] == STEPS
    assert header.training["steps"] == 500
    assert list(header.persons) == ["Sub01", "new-Sub01"]


@pytest.mark.slow
def test_a_larger_object_by_another_name_joins_a_person_alone(tmp_path: Path) -> None:
    base = base_model(tmp_path, objects=0)
    dataset = alone(tmp_path / "data", persons=0)
    (thing,) = dataset.objects.values()
    half = np.array([0.2, 1.4, 0.3])  # taller than the person, so that tables are laid out anew
    dataset = replace(dataset, objects={thing.name: ObjectShape(thing.name, -half, half)})
    run = TrainRun(steps=STEPS)
    model = add(base, dataset, {thing.name: "crate"}, tmp_path / "run", run, Progress(), SETTINGS)
    old, new = load_actor(base), load_actor(model)
    assert list(new.objects) == ["crate"]
    assert (new.model.field.layout.dims[0] > old.model.field.layout.dims[0]).any()  # type: ignore[attr-defined]
    person_views, _ = trained(objects=0)
    pose, camera = person_views.views[0].pose, person_views.views[0].camera
    one, other = old.render(pose, camera, FINAL), new.render(pose, camera, FINAL)
    assert one.rgb.tobytes() == other.rgb.tobytes()
    view = dataset.views[0]
    target = load_pixels(view).rgb
    shown = replace(view.pose, objects=("crate",))
    picture = new.render(shown, view.camera, FINAL)
    assert psnr(np.clip(picture.rgb, 0, 1), target) > psnr(np.zeros_like(target), target) + 8.0
    # Shading has never seen an object's pose: with one beside it, the person looks as before.
    away = np.eye(4)
    away[:3, 3] = 0.0, -30.0, 0.0  # out of the picture
    both = replace(pose, objects=("crate",), world_from_object=away[None])
    assert np.abs(new.render(both, camera, FINAL).rgb - one.rgb).max() < 1e-5


def test_dense_levels_that_would_not_fit_keep_their_size() -> None:
    _, trainer = trained()
    model = trainer.model
    huge = ObjectShape("hall", np.full(3, -20.0), np.full(3, 20.0))
    big = grown(model, [], [huge])
    dense, layout = model.field.layout.dense, big.field.layout
    assert dense.any()
    assert np.array_equal(layout.dense, dense)
    assert np.array_equal(layout.dims[dense], model.field.layout.dims[dense])
    assert (layout.dims[~dense] > model.field.layout.dims[~dense]).all()


@pytest.mark.slow
def test_a_run_that_was_ended_goes_on(tmp_path: Path) -> None:
    base = base_model(tmp_path)
    dataset = alone(tmp_path / "data", objects=0)
    whole = added(base, dataset, ["new-Sub01"], tmp_path / "whole", steps=60)
    part = tmp_path / "part"
    added(base, dataset, ["new-Sub01"], part, steps=30)
    # The schedule is another one with other steps; so the checkpoint of the longer run is what is continued.
    (part / "checkpoint.safetensors").write_bytes((tmp_path / "whole" / "checkpoint.safetensors").read_bytes())
    again = added(base, dataset, ["new-Sub01"], part, steps=60, resume=True)
    one, other = load_file(whole), load_file(again)
    assert all(one[name].equal(other[name]) for name in one)
    other_base = base_model(tmp_path / "whole", objects=0)
    with pytest.raises(CheckpointError, match="base was"):
        added(other_base, dataset, ["new-Sub01"], part, steps=60, resume=True)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["nobody"], "there is no 'nobody' in the data; they hold Sub02, box02"),
        (["Sub02"], "no view shows 'Sub02' without box02; name them as well with --identity"),
    ],
)
def test_what_cannot_be_added_is_named(tmp_path: Path, names: list[str], words: str) -> None:
    base = base_model(tmp_path)
    dataset = renamed(tiny_capture(tmp_path / "data"), {"Sub01": "Sub02", "box01": "box02"})
    with pytest.raises(DatasetError, match=words):
        added(base, dataset, names, tmp_path / "run")
    assert not (tmp_path / "run" / "model.safetensors").exists()


def test_a_name_that_is_taken_is_refused(tmp_path: Path) -> None:
    base = base_model(tmp_path)
    dataset = tiny_capture(tmp_path / "data", objects=0)
    with pytest.raises(ModelFileError, match=r"holds 'Sub01' already; give .* name, with --identity Sub01=NEW"):
        added(base, dataset, ["Sub01"], tmp_path / "run")


@pytest.mark.parametrize("method", ["joint", "arah", "arah-object"])
def test_models_that_nothing_can_be_added_to_say_so(tmp_path: Path, method: str) -> None:
    base = base_model(tmp_path, method)
    dataset = alone(tmp_path / "data", objects=0)
    with pytest.raises(ModelFileError, match=f"'{method}'.*'chona train'"):
        added(base, dataset, ["new-Sub01"], tmp_path / "run")


def test_tava_knows_no_objects(tmp_path: Path) -> None:
    base = base_model(tmp_path, "tava", objects=0)
    with pytest.raises(DatasetError, match=r"the method 'tava' of .* knows no objects"):
        added(base, alone(tmp_path / "data", persons=0), ["new-box01"], tmp_path / "run")


def test_the_model_itself_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    base = base_model(tmp_path / "run").rename(tmp_path / "run" / "model.safetensors")
    before = base.read_bytes()
    with pytest.raises(ModelFileError, match="where the model that is added to lies itself"):
        added(base, alone(tmp_path / "data", objects=0), ["new-Sub01"], tmp_path / "run")
    assert base.read_bytes() == before

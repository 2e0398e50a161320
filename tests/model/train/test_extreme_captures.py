"""Extreme captures, through the real loop: each trains, or is refused before the first step by a name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tiny_capture import tiny_capture
from tiny_runs import fast_trainer, paper_trainer, train

import chona_model.train.pixels as pixels_module
from chona_model.data.checks import check_data
from chona_model.data.dataset import Dataset, DatasetError, SkinnedSurface
from chona_model.data.images import load_pixels
from chona_model.train.errors import TrainingError
from chona_model.train.run import TrainRun, make_trainer

PRESETS = pytest.mark.parametrize("preset", ["fast", "paper"])
VIEW = "Date01_Sub01_box01_t0001.000_k1"


@pytest.fixture
def capture(tmp_path: Path) -> Dataset:
    return tiny_capture(tmp_path / "capture", frames=2, cameras=2)


def refused(patch, dataset: Dataset, out: Path, preset: str, words: list[str], **run: object) -> None:
    with pytest.raises(DatasetError) as caught:
        train(patch, dataset, out, preset=preset, steps=2, **run)
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert not (out / "model.safetensors").exists() and "\n" not in str(caught.value)


def of_one_view(dataset: Dataset, **changes: object) -> Dataset:
    """The first view alone, its pose changed."""
    view = dataset.views[0]
    return replace(dataset, views=(replace(view, pose=replace(view.pose, **changes)),))


def spoil_camera(dataset: Dataset, name: str) -> None:
    getattr(dataset.views[3].camera, name)[1, 2] = math.nan


def spoil_person(dataset: Dataset, **changes: object) -> Dataset:
    person = replace(dataset.persons["Sub01"], **changes)
    return replace(dataset, persons={"Sub01": person})


SURFACE = SkinnedSurface(np.array([[0.0, 0.0, math.nan]]), np.ones((1, 3)), np.zeros((0, 3), dtype=np.int64))

SPOILS: dict[str, tuple[Callable[[Dataset], Dataset | None], list[str]]] = {
    "intrinsics": (lambda d: spoil_camera(d, "intrinsics"), ["t0001.000_k", "intrinsics", "nan at [1, 2]"]),
    "camera pose": (lambda d: spoil_camera(d, "world_from_camera"), [VIEW, "world_from_camera", "1 of 16"]),
    "bone": (lambda d: d.views[3].pose.world_from_bone[1].fill(math.inf), ["t0001.000", "bone 'chest'", "inf"]),
    "object": (lambda d: d.views[3].pose.world_from_object[0, :3].fill(math.nan), ["object 'box01'", "12 of 16"]),
    "bones": (lambda d: of_one_view(d, world_from_bone=np.eye(4)),
              ["t0000.000_k0", "(4, 4)", "(3, 4, 4)"]),
    "stranger": (lambda d: of_one_view(d, person="Robin"),
                 ["t0000.000_k0", "'Robin'"]),
    "joints": (lambda d: spoil_person(d, rest_joints=np.full((3, 3), math.nan)), ["rest joints of 'Sub01'", "9 of 9"]),
    "surface": (lambda d: spoil_person(d, surface=SURFACE),
                ["surface of 'Sub01'"]),
    "box": (lambda d: replace(d, objects={"box01": replace(d.objects["box01"], upper=np.full(3, -9.0))}),
            ["box of 'box01'"]),
    "no views": (lambda d: replace(d, views=()), ["not one view"]),
    "unused": (lambda d: replace(d, objects={**d.objects, "box02": replace(d.objects["box01"], name="box02")}),
               ["no view has the object box02"]),
}  # fmt: skip


@PRESETS
@pytest.mark.parametrize("name", SPOILS)
def test_what_is_not_finite_is_refused_by_name(capture, preset: str, name: str) -> None:
    """The trainers as they are, full size: nothing is built before the capture is looked at."""
    spoil, words = SPOILS[name]
    with pytest.raises(DatasetError) as caught:
        make_trainer(spoil(capture) or capture, TrainRun(preset=preset))
    assert all(word in str(caught.value) for word in words), str(caught.value)


def plant(change: Callable[..., dict], label: str = VIEW) -> Callable:
    """``load_pixels`` with one view's pixels changed in memory."""

    def load(view, scale: float = 1.0):
        pixels = load_pixels(view, scale)
        return replace(pixels, **change(pixels)) if view.label == label else pixels

    return load


def with_pixel(array: np.ndarray, value: float) -> np.ndarray:
    copy = array.copy()
    copy[5, 7] = value
    return copy


@PRESETS
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: {"rgb": with_pixel(p.rgb, math.nan)}, [VIEW, "image", "3 of 2304", "nan at [5, 7, 0]"]),
        (lambda p: {"rgb": with_pixel(p.rgb, 255.0)}, [VIEW, "255", "0…1"]),
        (lambda p: {"person": p.person.astype(np.float32)}, [VIEW, "person mask", "float32"]),
        (lambda p: {"person": p.person | p.object}, [VIEW, "at once"]),
        (lambda p: {"object": p.object[:-1]}, [VIEW, "(23, 32)", "(24, 32)"]),
    ],
    ids=["nan", "bytes", "float mask", "overlap", "shape"],
)
def test_planted_pixels_are_refused_by_name(capture, monkeypatch, tmp_path, preset: str, change, words) -> None:
    monkeypatch.setattr(pixels_module, "load_pixels", plant(change))
    refused(monkeypatch, capture, tmp_path / "run", preset, words)


@pytest.mark.parametrize("array", [np.full((24, 32), 40_000, np.uint16), np.full((24, 32), math.nan, np.float32)])
def test_wide_samples_are_refused_and_not_clipped(capture, array: np.ndarray) -> None:
    view = capture.views[0]
    # Pillow goes by the content, whatever the name says.
    Image.fromarray(array).save(view.image, format="PNG" if array.dtype == np.uint16 else "TIFF")
    with pytest.raises(DatasetError, match="expected 8 bits a channel"):
        load_pixels(view)


def test_check_data_tells_of_a_camera_that_is_not_finite(capture) -> None:
    spoil_camera(capture, "intrinsics")
    assert any(VIEW in warning for warning in check_data(capture, None).warnings)


def paint(dataset: Dataset, kind: str, mask: np.ndarray) -> None:
    for view in dataset.views:
        Image.fromarray(mask).save(getattr(view, kind))


@PRESETS
@pytest.mark.parametrize(("kind", "name"), [("person_mask", "Sub01"), ("object_mask", "box01")])
def test_who_is_never_seen_is_named(capture, monkeypatch, tmp_path, preset: str, kind: str, name: str) -> None:
    paint(capture, kind, np.zeros((24, 32), dtype=np.uint8))
    refused(monkeypatch, capture, tmp_path / "run", preset, [f"no room for {name}", "4 views", "check-data"])


@PRESETS
def test_images_of_one_pixel(capture, monkeypatch, tmp_path, preset: str) -> None:
    words = ["no room for Sub01, box01", "1x1 pixels", "image scale 0.01"]
    refused(monkeypatch, capture, tmp_path / "run", preset, words, image_scale=0.01)


@PRESETS
def test_masks_of_one_pixel(capture, monkeypatch, tmp_path, preset: str) -> None:
    """Where their rays meet nowhere there is no room; otherwise what is learned is a speck, as the masks say."""
    mask = np.zeros((24, 32), dtype=np.uint8)
    mask[12, 16] = 255
    paint(capture, "person_mask", mask)
    try:
        path = train(monkeypatch, capture, tmp_path / "run", preset=preset, steps=5)
    except (DatasetError, TrainingError) as error:
        assert "check-data" in str(error) and ("Sub01" in str(error) or "empty picture" in str(error))
    else:
        assert path.is_file()


@PRESETS
@pytest.mark.parametrize("size", [(32, 24), (5, 4)], ids=["", "fewer pixels than rays"])
def test_one_frame_of_one_camera(monkeypatch, tmp_path, preset: str, size: tuple[int, int]) -> None:
    dataset = tiny_capture(tmp_path / "capture", frames=1, cameras=1, size=size)
    assert train(monkeypatch, dataset, tmp_path / "run", preset=preset, steps=3).is_file()


@PRESETS
def test_a_person_alone_and_an_object_alone(monkeypatch, tmp_path, preset: str) -> None:
    """One identity: CIL has nothing to exchange, and must not fail for it."""
    for persons, objects in ((1, 0), (0, 1)):
        dataset = tiny_capture(tmp_path / f"{persons}", persons=persons, objects=objects, frames=1, cameras=2)
        assert train(monkeypatch, dataset, tmp_path / f"run{persons}", preset=preset, steps=3).is_file()


@PRESETS
def test_identical_codes_come_apart(monkeypatch, tmp_path, preset: str) -> None:
    """Two persons and two objects that start as one: their pictures differ, so their codes must come to."""
    dataset = tiny_capture(tmp_path / "capture", persons=2, objects=2, frames=1, cameras=2)
    trainer = {"fast": fast_trainer, "paper": paper_trainer}[preset](dataset, TrainRun())
    ends = ("codes.persons", "codes.objects", "person_codes", "object_codes")
    codes = {
        name: value for name, value in trainer.tensors().items() if name.startswith("model.") and name.endswith(ends)
    }
    assert len(codes) == 2 and all(len(value) == 2 for value in codes.values())
    with torch.no_grad():
        for value in codes.values():
            value[1] = value[0]
    train(monkeypatch, dataset, tmp_path / "run", lambda d, r: trainer, steps=4)
    for value in codes.values():
        assert torch.isfinite(value).all() and not torch.equal(value[0], value[1])

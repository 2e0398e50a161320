"""Split files, presets and checkpoints that are damaged or lie."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from fuzzing import start
from mutations import deep_json, join_safetensors, split_safetensors, spoiled_json, spoiled_safetensors

pytestmark = pytest.mark.faults


def splits(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    from chona_model.data.splits import read_split

    content = {"novel": {"chair": {"train": ["A_Sub01_chair", "B_Sub01_chair"], "test": "novel.chair.train"}},
               "boxes": {"A_Sub01_box": {"train": ["t0001.000"]}}, "train": [["1_2_3", 4, "x.png"]]}  # fmt: skip
    path = folder / "splits.json"

    def read(text: bytes) -> None:
        path.write_bytes(text)
        first: Exception | None = None
        for key in ("novel.chair.test", "boxes.A_Sub01_box.train", "train"):
            try:
                names = read_split(f"{path}:{key}")
                assert names and all(isinstance(name, str) for name in names)
                "".join(names).encode()
            except ValueError as error:
                first = first or error
        if first is not None:
            raise first

    read(json.dumps(content).encode())
    return spoiled_json(content), read


def presets(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    from chona_model.presets import read_preset
    from chona_model.settings import RENDER_PRESETS

    content = {"format": "chona-preset", "version": 1, "settings": asdict(RENDER_PRESETS["final"])}
    path = folder / "mine.json"

    def read(text: bytes) -> None:
        path.write_bytes(text)
        settings = read_preset(path)
        numbers = (
            settings.step,
            settings.stop,
            settings.tolerance,
            settings.resolution,
            settings.exact.inverse.predict,
        )
        assert np.isfinite(numbers).all() and settings.step > 0

    read(json.dumps(content).encode())
    return spoiled_json(content), read


SETTINGS = {"seed": 0, "persons": ["Sub01"]}


def _checkpoint(run: Path) -> bytes:
    import torch

    from chona_model.train.checkpoint import NAME, save_checkpoint
    from chona_model.train.guard import GuardState

    position = {"step": 3, "seconds": 1.5, "guard": asdict(GuardState())}
    save_checkpoint(run, {"model.a": torch.arange(6.0), "adam.0.step": torch.ones(())}, position, SETTINGS)
    return (run / NAME).read_bytes()


def checkpoints(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    from chona_model.train.checkpoint import NAME, load_checkpoint

    valid = _checkpoint(folder)

    def read(content: bytes) -> None:
        (folder / NAME).write_bytes(content)
        state, position = load_checkpoint(folder, SETTINGS)
        assert position.step >= 0 and np.isfinite(position.seconds) and isinstance(state, dict)

    read(valid)
    return spoiled_safetensors(valid, ("position", "settings")), read


@pytest.mark.parametrize(("family", "few"), [("splits", 120), ("presets", 120), ("checkpoints", 80)])
def test_spoiled_texts_and_checkpoints_are_refused_or_read_whole(tmp_path: Path, often, family: str, few: int) -> None:
    report = start("test_fuzz_texts", family, often(few, 10_000), tmp_path)
    assert f"{family}: 0 refused" not in report


@pytest.mark.parametrize("text", [deep_json(), '{"a":' * 50_000, "1" * 6000, '["\\ud800"]', "NaN", "", "\xff"])
def test_texts_that_break_parsers(tmp_path: Path, text: str) -> None:
    from chona_model.data.dataset import DatasetError
    from chona_model.data.splits import read_split
    from chona_model.presets import read_preset
    from chona_model.settings import SettingsError

    path = tmp_path / "a.json"
    path.write_bytes(text.encode("latin1"))
    with pytest.raises(SettingsError, match=r"cannot use the preset|is no preset"):
        read_preset(path)
    with pytest.raises(DatasetError, match=r"a\.json"):
        read_split(f"{path}:train")


@pytest.mark.parametrize("value", [10**400, 10**30, -1, float("nan"), "0.01", True, None, [1]])
def test_a_preset_with_an_impossible_number_is_refused_by_its_field(tmp_path: Path, value: object) -> None:
    from chona_model.presets import read_preset
    from chona_model.settings import RENDER_PRESETS, SettingsError

    settings = asdict(RENDER_PRESETS["final"]) | {"newton_steps": value}
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({"format": "chona-preset", "version": 1, "settings": settings}))
    with pytest.raises(SettingsError, match=r"mine\.json.*(newton_steps|out of range|JSON is malformed|invalid)"):
        read_preset(path)


@pytest.mark.parametrize(
    "position",
    [{"step": -1, "seconds": 1.0}, {"step": 3, "seconds": float("nan")}, {"step": "3", "seconds": 1.0},
     {"seconds": 1.0},
     [], None, {"step": 10**30, "seconds": 1.0},
     {"step": 3, "seconds": 1.0, "guard": {"error": "x"}}],
)  # fmt: skip
def test_a_checkpoint_of_no_possible_position_is_refused(tmp_path: Path, position: object) -> None:
    from chona_model.train.checkpoint import NAME, CheckpointError, load_checkpoint

    header, data = split_safetensors(_checkpoint(tmp_path))
    header["__metadata__"]["position"] = json.dumps(position)
    (tmp_path / NAME).write_bytes(join_safetensors(header, data))
    with pytest.raises(CheckpointError, match=r"cannot continue from .*train without --resume"):
        load_checkpoint(tmp_path, SETTINGS)

"""The file of a model is written over, cut off or replaced while it is loaded: pictures stay those of one model."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from ball_model import ball_actor, ball_pose
from scene_files import write_poses
from tiny_capture import tiny_cameras

from chona_model.bake import bake
from chona_model.bake_report import REPLACED
from chona_model.formats.exr import read_frame
from chona_model.formats.model_file import ModelFileError, file_hash, write_trade
from chona_model.model_store import load_actor, save_actor
from chona_model.progress import Progress
from chona_model.settings import RENDER_PRESETS

FRAMES = 3
MEASURED = {"version": 1, "size": [32, 24], "views": 1, "presets": {}, "machine": {}}


class Meddler(io.StringIO):
    """Takes a bake's events, and does something to the model's file when one of a kind comes."""

    def __init__(self, event: str, deed: Callable[[], object]) -> None:
        super().__init__()
        self._event, self._deed = event, deed

    def write(self, text: str) -> int:
        if f'"event": "{self._event}"' in text:
            self._event = ""
            self._deed()
        return super().write(text)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    save_actor(tmp_path / "model.safetensors", ball_actor(), "chona", {}, {})
    return tmp_path / "model.safetensors"


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """A model of the same object in other colours, with as many bytes."""
    actor = ball_actor()
    with torch.no_grad():
        for parameter in actor.model.field.parameters():
            parameter.add_(0.5)
    save_actor(tmp_path / "other.safetensors", actor, "chona", {}, {})
    return tmp_path / "other.safetensors"


@pytest.fixture
def shot(tmp_path: Path) -> Path:
    poses = []
    for place in np.linspace(-0.2, 0.2, FRAMES):
        frame = np.eye(4)
        frame[0, 3] = place
        poses.append(ball_pose(frame))
    return write_poses(tmp_path / "roll.shot.npz", tiny_cameras(1, (32, 24))[0], poses)


def baked(model: Path, shot: Path, out: Path, events: io.StringIO | None = None) -> dict:
    """The last event of a bake."""
    events = io.StringIO() if events is None else events
    bake(model, shot, out, None, "draft", False, Progress("json", output=events))
    return json.loads(events.getvalue().splitlines()[-1])


def pictures(out: Path) -> list[np.ndarray]:
    return [read_frame(path)[0].combined for path in sorted(out.glob("*.exr"))]


def test_a_loaded_model_does_not_change_with_its_file(model: Path, other: Path) -> None:
    """Written over in place, as ``cp`` does: the same file, other bytes."""
    camera, pose = tiny_cameras(1, (32, 24))[0], ball_pose(np.eye(4))
    kept = load_actor(model)
    before = kept.render(pose, camera, RENDER_PRESETS["draft"]).rgb
    model.write_bytes(other.read_bytes())
    after, new = (each.render(pose, camera, RENDER_PRESETS["draft"]).rgb for each in (kept, load_actor(model)))
    np.testing.assert_array_equal(before, after)
    assert np.abs(np.asarray(new) - np.asarray(before)).max() > 0.01, "the files would look the same"


def test_tensors_have_memory_of_their_own(tmp_path: Path) -> None:
    from chona_model.formats.tensor_file import write_tensors
    from chona_model.tensor_reader import TensorReader

    path = tmp_path / "tensors.safetensors"
    write_tensors(path, {"a": torch.ones(1000)}, {})
    with TensorReader(path) as tensors:
        whole, rows = tensors["a"], tensors.rows("a", [3, 5])
    with path.open("r+b") as file:
        file.seek(path.stat().st_size - 4000)
        file.write(b"\0" * 4000)
    assert float(whole.min()) == float(rows.min()) == 1.0


@pytest.mark.parametrize("how", ["at once", "in place", "half"])
def test_all_frames_are_of_one_model(model: Path, other: Path, shot: Path, tmp_path: Path, how: str) -> None:
    content, new = model.read_bytes(), other.read_bytes()
    expected = tmp_path / "expected"
    assert "model_replaced" not in baked(model, shot, expected)
    deeds = {
        "at once": lambda: other.replace(model),
        "in place": lambda: model.write_bytes(new),
        "half": lambda: model.write_bytes(new[: len(new) // 2]),
    }
    out, digest = tmp_path / "out", file_hash(model)
    result = baked(model, shot, out, Meddler("progress", deeds[how]))
    assert result["written"] == FRAMES and result["model_replaced"] is True
    for one, two in zip(pictures(expected), pictures(out), strict=True):
        np.testing.assert_array_equal(one, two)
    assert {read_frame(path)[1].model for path in out.glob("*.exr")} == {digest}
    model.write_bytes(new)
    again = baked(model, shot, out)
    assert (again["written"], again["skipped"]) == (FRAMES, 0) and "model_replaced" not in again
    model.write_bytes(content)


def test_a_model_replaced_before_it_is_read_is_refused(model: Path, other: Path, shot: Path, tmp_path: Path) -> None:
    """The frames' files would name one model and show another."""
    out = tmp_path / "out"
    with pytest.raises(ModelFileError, match=r"was replaced before this bake had read it.*bake again"):
        baked(model, shot, out, Meddler("start", lambda: other.replace(model)))
    assert not list(out.glob("*.exr"))
    assert baked(model, shot, out)["written"] == FRAMES


def test_what_is_measured_of_a_model_makes_no_other_model(model: Path, shot: Path, tmp_path: Path) -> None:
    result = baked(model, shot, tmp_path / "out", Meddler("start", lambda: write_trade(model, MEASURED)))
    assert result["written"] == FRAMES and "model_replaced" not in result


def test_it_is_said_on_a_terminal(model: Path, shot: Path, tmp_path: Path) -> None:
    report = bake(model, shot, tmp_path / "out", None, "draft", False, Progress())
    assert REPLACED not in report.sentence() and REPLACED in replace(report, model_replaced=True).sentence()

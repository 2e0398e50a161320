"""Model files: what was measured of a model travels in its file, and nothing else of the file changes."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from chona_model.formats.model_file import ModelFileError, file_hash, read_header, write_trade

CONTENT = {
    "format": "chona-model", "version": 1, "method": "chona", "field": "grid",
    "skeleton": {"names": ["hips"], "parents": [-1]}, "persons": {}, "objects": {}, "object_distance": 0.5,
    "settings": {}, "training": {}, "shape": {},
}  # fmt: skip


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "model.safetensors"
    tensors = {"a": torch.arange(7, dtype=torch.uint8), "b": torch.randn(3, 5, generator=torch.manual_seed(0))}
    save_file(tensors, path, metadata={"chona": json.dumps(CONTENT), "other": "kept"})
    return path


def test_a_trade_travels_in_the_file_and_leaves_the_rest_alone(model: Path) -> None:
    before, digest = load_file(model), file_hash(model)
    assert read_header(model).trade is None
    for trade in ({"presets": {"final": {"psnr": 31.25}}}, {"presets": {}, "note": "σ ≤ 3"}):
        write_trade(model, trade)
        assert read_header(model).trade == trade
        after = load_file(model)
        assert all(torch.equal(before[name], after[name]) for name in before) and after.keys() == before.keys()
        with safe_open(model, "pt") as file:
            assert file.metadata()["other"] == "kept"
            assert json.loads(file.metadata()["chona"]) == CONTENT
        assert file_hash(model) == digest, "frames that were baked with the model would be baked again"
        assert struct.unpack("<Q", model.read_bytes()[:8])[0] % 8 == 0
    assert [path.name for path in model.parent.iterdir()] == [model.name]


def test_the_hash_is_of_metadata_and_data(model: Path) -> None:
    digest = file_hash(model)
    content = bytearray(model.read_bytes())
    content[-1] ^= 1
    model.write_bytes(content)
    assert file_hash(model) != digest
    content[-1] ^= 1
    model.write_bytes(bytes(content).replace(b'\\"chona\\"', b'\\"chonA\\"'))
    assert file_hash(model) != digest


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("no model")
    with pytest.raises(ModelFileError, match="is no safetensors file"):
        write_trade(path, {})
    assert path.read_text() == "no model"

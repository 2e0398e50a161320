"""Model files that are damaged, lie or attack: refused by name, or read whole."""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from fuzzing import endured, start
from mutations import deep_json, join_safetensors, split_safetensors, spoiled_safetensors

pytestmark = pytest.mark.faults
ENTRIES = ("chona", "chona", "chona.trade")


def _read_all(path: Path, content: bytes) -> None:
    """Everything that commands do with a model file before they render; what is read must be whole and finite."""
    from chona_model.formats.model_file import file_hash, read_header
    from chona_model.info import describe, to_text
    from chona_model.model_store import load_actor

    path.write_bytes(content)
    refused = [
        not endured(step)
        for step in (
            lambda: read_header(path), lambda: file_hash(path), lambda: to_text(describe(path)).encode(),
            lambda: _whole(load_actor(path)), lambda: load_actor(path, objects=()), lambda: _trade_used(path),
        )
    ]  # fmt: skip
    if refused[0] and not all(refused[2:]):
        raise AssertionError(f"some readers take what others refuse: {refused}")
    if any(refused):
        read_header(path)
        _whole(load_actor(path))


def _trade_used(path: Path) -> None:
    from chona_model.formats.model_file import check_trade, read_header
    from chona_model.trade.estimate import reference_shot

    header = read_header(path)
    if header.trade is not None:
        check_trade(path, header.trade)
        reference_shot(header.trade, header.skeleton.names)


def _whole(actor: Any) -> None:
    for name, tensor in actor.tensors().items():
        assert np.isfinite(tensor.float().numpy()).all(), name
    for person in actor.persons.values():
        assert np.isfinite(person.rest_joints).all() and person.rest_joints.shape == (len(actor.skeleton), 3)
    for thing in actor.objects.values():
        assert (thing.lower < thing.upper).all()


def grid(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    from untrained_models import write_grid_model

    valid = write_grid_model(folder / "valid.safetensors").read_bytes()
    _read_all(folder / "model.safetensors", valid)
    return spoiled_safetensors(valid, ENTRIES), lambda content: _read_all(folder / "model.safetensors", content)


def exact(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    from untrained_models import write_exact_model

    valid = write_exact_model(folder / "valid.safetensors").read_bytes()
    _read_all(folder / "model.safetensors", valid)
    return spoiled_safetensors(valid, ENTRIES), lambda content: _read_all(folder / "model.safetensors", content)


def in_blender(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    """The add-on's reader of headers."""
    from untrained_models import write_grid_model

    from chona_blender.model_header import read_model_header

    valid = write_grid_model(folder / "valid.safetensors").read_bytes()

    def read(content: bytes) -> None:
        (folder / "model.safetensors").write_bytes(content)
        header = read_model_header(folder / "model.safetensors")
        for joints in header.persons.values():
            assert np.isfinite(joints).all()
        for corners in header.objects.values():
            assert np.isfinite(corners).all() and np.shape(corners) == (2, 3)

    read(valid)
    return spoiled_safetensors(valid, ENTRIES), read


@pytest.mark.parametrize(("family", "few"), [("grid", 40), ("exact", 30), ("in_blender", 60)])
def test_spoiled_model_files_are_refused_or_read_whole(tmp_path: Path, often, family: str, few: int) -> None:
    report = start("test_fuzz_models", family, often(few, 10_000), tmp_path)
    assert " refused, " in report and f"{family}: 0 refused" not in report


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    from untrained_models import write_grid_model

    return write_grid_model(tmp_path_factory.mktemp("models") / "model.safetensors").read_bytes()


def _with(content: bytes, change: Callable[[dict], object]) -> bytes:
    """A model file with its description changed."""
    header, data = split_safetensors(content)
    description = json.loads(header["__metadata__"]["chona"])
    change(description)
    header["__metadata__"]["chona"] = json.dumps(description)
    return join_safetensors(header, data)


def _set(*path: Any) -> Callable[[dict], object]:
    *keys, last, value = path

    def change(content: Any) -> None:
        for key in keys:
            content = content[key]
        content[last] = value

    return change


LIES: dict[str, tuple[Callable[[dict], object], str]] = {
    "corners of the nodes": (_set("shape", "grids", 0, "dims", [90, 90, 90]),
                             r"nodes' is I32 .*expected I32 \[729000\]"),
    "negative corners": (_set("shape", "grids", 0, "dims", [-5, -5, 9]), "skinning grid of"),
    "one corner": (_set("shape", "grids", 0, "dims", [1, 9, 9]), "skinning grid of"),
    "NaN joints": (_set("persons", "Sub01", "rest_joints", 1, 2, float("nan")),
                   "rest joints of 'Sub01' are not 3 points"),
    "joints far away": (_set("persons", "Sub01", "rest_joints", 1, 2, 1e30), "rest joints of 'Sub01'"),
    "a joint too few": (lambda c: c["persons"]["Sub01"]["rest_joints"].pop(), "rest joints of 'Sub01'"),
    "an empty box": (_set("objects", "box01", "lower", [1.0, 1.0, 1.0]), "box of 'box01'"),
    "a huge box of cells": (_set("shape", "parts", 1, "upper", [9e3, 9e3, 9e3]), r"'object.box01.density' is F32"),
    "an infinite box": (_set("shape", "parts", 0, "upper", 1, float("inf")), "the box from"),
    "tiny cells": (_set("shape", "sizes", "occupancy_cell", 1e-4), "'person.Sub01.density' is F32"),
    "no cells": (_set("shape", "sizes", "occupancy_cell", 0.0), "out of range"),
    "huge tables": (_set("shape", "sizes", "field", "rows", 24), "'person.Sub01.table' is F32"),
    "impossible tables": (_set("shape", "sizes", "field", "rows", 10**9), "out of range"),
    "huge perceptrons": (_set("shape", "sizes", "field", "hidden", 1 << 30), "out of range"),
    "levels that overflow": (_set("shape", "tables", "dims", [[1 << 22] * 3] * 4),
                             "levels or corners are out of range"),
    "more slots": (_set("shape", "sizes", "object_slots", 2), "pose_in.weight|offset_mix"),
    "an unknown size": (_set("shape", "sizes", "new", 1), "unknown field 'new': update"),
    "bones": (lambda c: (c["skeleton"]["names"].append("tail"), c["skeleton"]["parents"].append(0),
                         c["persons"]["Sub01"]["rest_joints"].append([0.0, 0.0, 0.0])), "logits"),
    "a cycle of bones": (_set("skeleton", "parents", [-1, 2, 1]), "parent 2"),
    "a hundred thousand bones": (_set("skeleton", {"names": [str(n) for n in range(100_000)],
                                                   "parents": [-1] + [0] * 99_999}), "at most 2048"),
    "text for numbers": (_set("shape", "sizes", "node_cell", "0.25"), "Expected `float`"),
    "half a letter": (_set("method", "\ud800"), "surrogates not allowed"),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_metadata_that_lies_is_refused_by_name(tmp_path: Path, model: bytes, lie: str) -> None:
    from chona_model.formats.model_file import ModelFileError
    from chona_model.model_store import load_actor

    change, message = LIES[lie]
    path = tmp_path / "model.safetensors"
    path.write_bytes(_with(model, change))
    with pytest.raises(ModelFileError, match=message):
        load_actor(path)


def _tensor(content: bytes, name: str, values: bytes) -> bytes:
    header, data = split_safetensors(content)
    begin, _ = header[name]["data_offsets"]
    return join_safetensors(header, data[:begin] + values + data[begin + len(values) :])


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("person.Sub01.nodes", struct.pack("<i", -1), "name nodes beyond"),
        ("person.Sub01.nodes", struct.pack("<i", 10**9), "name nodes beyond"),
        ("person.Sub01.points", struct.pack("<f", float("nan")), "points' holds numbers that are not finite"),
        ("field.density_out.bias", struct.pack("<f", float("inf")), "not finite"),
    ],
)
def test_indices_that_leave_their_arrays_and_nan_are_refused(
    tmp_path: Path, model: bytes, name: str, values: bytes, message: str
) -> None:
    """The kernels check no bounds: they would read, or crash, elsewhere."""
    from chona_model.formats.model_file import ModelFileError
    from chona_model.model_store import load_actor

    path = tmp_path / "model.safetensors"
    path.write_bytes(_tensor(model, name, values))
    with pytest.raises(ModelFileError, match=message):
        load_actor(path)


def test_a_quality_that_nobody_measured_is_told(tmp_path: Path, model: bytes) -> None:
    from chona_model.info import describe, to_text

    header, data = split_safetensors(model)
    trade = json.loads(header["__metadata__"]["chona.trade"])
    trade["presets"]["draft"]["psnr"] = None
    header["__metadata__"]["chona.trade"] = json.dumps(trade)
    path = tmp_path / "model.safetensors"
    path.write_bytes(join_safetensors(header, data))
    words = to_text(describe(path))
    assert "  draft: no quality, 0.1 s a frame" in words and "  final: 30.0 dB, 0.1 s a frame" in words


def test_a_missing_tensor_is_no_random_one(tmp_path: Path, model: bytes) -> None:
    """Perceptrons that a file lacks would keep the numbers they begin with."""
    from chona_model.formats.model_file import ModelFileError
    from chona_model.model_store import load_actor

    header, data = split_safetensors(model)
    header["field.unknown"] = header.pop("field.colour_out.bias")
    path = tmp_path / "model.safetensors"
    path.write_bytes(join_safetensors(header, data))
    with pytest.raises(ModelFileError, match=r"field\.colour_out\.bias' is missing"):
        load_actor(path)


@pytest.mark.parametrize(
    "content",
    [
        struct.pack("<Q", 1 << 40) + b"{}", struct.pack("<Q", (1 << 64) - 1) + b"{}", struct.pack("<Q", 8),
        join_safetensors(deep_json().encode(), b""), join_safetensors(b'{"a":' * 50_000, b""),
        join_safetensors({"a": {"dtype": "F32", "shape": [1 << 38], "data_offsets": [0, 1 << 40]}}, b""),
        join_safetensors({"a": 5}, b""), join_safetensors({"a": {"data_offsets": "x"}}, b""),
        join_safetensors({"__metadata__": {"chona": 5}}, b""), join_safetensors({"__metadata__": []}, b""),
        join_safetensors({"__metadata__": {"chona": "[]"}}, b""),
        join_safetensors({"__metadata__": {"chona": "1" * 6000}}, b""),
        join_safetensors({"__metadata__": {"chona": deep_json()}}, b""), b"", b"\0" * 16,
    ],
)  # fmt: skip
def test_headers_that_claim_too_much_or_are_none(tmp_path: Path, content: bytes) -> None:
    from chona_blender.errors import ChonaError
    from chona_blender.model_header import read_model_header
    from chona_model.formats.model_file import ModelFileError, read_header

    path = tmp_path / "model.safetensors"
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match=r"expected|copy it again"):
        read_header(path)
    with pytest.raises(ChonaError, match=r"Choose another|copy it again"):
        read_model_header(path)

"""Baked frames: round trip, resuming, and what another program reads in them."""

from __future__ import annotations

import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chona_model.formats.atomic import atomic_path, write_bytes
from chona_model.formats.exr import (
    ExrError,
    FrameHeader,
    FrameLayers,
    frame_name,
    is_finished,
    read_frame,
    write_frame,
)
from chona_model.passes import Passes

HEADER = FrameHeader("a" * 64, "b" * 64, "final", '{"samples": 64}', 1.5, -3)
NAMES = ("combined", "depth", "human", "object", "confidence")


def _layers(height: int, width: int, seed: int = 0) -> FrameLayers:
    random = np.random.default_rng(seed)
    depth = np.where(random.random((height, width)) < 0.5, 1e10, 2.5).astype(np.float32)
    return FrameLayers(random.random((height, width, 4)), depth, *(random.random((3, height, width))))


@pytest.mark.parametrize(("height", "width"), [(1, 1), (7, 5), (16, 3), (33, 64)])
def test_a_frame_comes_back(tmp_path: Path, height: int, width: int) -> None:
    path, layers = tmp_path / "walk_0001.exr", _layers(height, width)
    write_frame(path, layers, HEADER)
    back, header = read_frame(path)
    assert header == HEADER
    for name in NAMES:
        stored = getattr(layers, name).astype(np.float32 if name == "depth" else np.float16)
        assert (getattr(back, name) == stored).all()
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk_0001.exr"]


def test_depth_keeps_what_half_precision_cannot(tmp_path: Path) -> None:
    layers = _layers(4, 4)
    layers.depth[:] = 1e10
    layers.combined[..., 0] = 1e6
    write_frame(tmp_path / "a.exr", layers, HEADER)
    back, _ = read_frame(tmp_path / "a.exr")
    assert (back.depth == np.float32(1e10)).all()
    assert (back.combined[..., 0] == 65504).all()


def test_a_finished_frame_is_known_by_model_and_shot(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    assert not is_finished(path, HEADER.model, HEADER.shot)
    write_frame(path, _layers(20, 20), HEADER)
    assert is_finished(path, HEADER.model, HEADER.shot)
    assert not is_finished(path, "c" * 64, HEADER.shot)
    assert not is_finished(path, HEADER.model, "c" * 64)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("exr") / "a.exr"
    write_frame(path, _layers(40, 20), HEADER)
    return path.read_bytes()


@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_no_truncated_frame_counts_as_finished(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    path = tmp_path_factory.mktemp("exr") / "a.exr"
    path.write_bytes(whole[: int(len(whole) * share)])
    assert not is_finished(path, HEADER.model, HEADER.shot)
    with pytest.raises(ExrError, match=r"a\.exr"):
        read_frame(path)


@given(place=st.floats(0.0, 1.0), length=st.integers(4, 64))
def test_a_damaged_frame_is_refused_or_reads_the_same(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, place: float, length: int
) -> None:
    path = tmp_path_factory.mktemp("exr") / "a.exr"
    start = int((len(whole) - length) * place)
    path.write_bytes(whole[:start] + b"\xff" * length + whole[start + length :])
    if is_finished(path, HEADER.model, HEADER.shot):  # only attributes may have changed
        assert start < 1200


def test_other_files_are_not_finished_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    for content in (b"", b"\x89PNG", b"\x76\x2f\x31\x01", struct.pack("<II", 20000630, 0x1002) + bytes(64)):
        path.write_bytes(content)
        assert not is_finished(path, HEADER.model, HEADER.shot)


@pytest.mark.parametrize("name", NAMES)
def test_values_that_are_not_finite_are_refused(tmp_path: Path, name: str) -> None:
    layers = _layers(4, 4)
    getattr(layers, name)[1, 1] = np.nan
    with pytest.raises(ExrError, match=f"{name} has .* not finite"):
        write_frame(tmp_path / "a.exr", layers, HEADER)
    assert not list(tmp_path.iterdir())


def test_layers_of_other_sizes_are_refused(tmp_path: Path) -> None:
    layers = _layers(4, 4)
    wrong = FrameLayers(layers.combined, layers.depth, layers.human[:2], layers.object, layers.confidence)
    with pytest.raises(ExrError, match=r"human has the shape \(2, 4\), expected \(4, 4\)"):
        write_frame(tmp_path / "a.exr", wrong, HEADER)


def test_a_failed_write_leaves_the_old_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_bytes(path, b"old")
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_bytes(b"half")
        raise RuntimeError
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.exr"]


def test_frame_names_keep_the_sign() -> None:
    assert [frame_name("walk", frame) for frame in (1, 12345, -1, 0)] == [
        "walk_0001.exr",
        "walk_12345.exr",
        "walk_-0001.exr",
        "walk_0000.exr",
    ]


def test_another_program_reads_the_frame(tmp_path: Path) -> None:
    program = shutil.which("exrheader")
    if program is None:
        pytest.skip("exrheader (Debian package openexr) is not on PATH")
    write_frame(tmp_path / "a.exr", _layers(20, 30), HEADER)
    text = subprocess.run([program, str(tmp_path / "a.exr")], capture_output=True, text=True, check=True).stdout
    for letter in "RGBA":
        assert f"CHONA.Combined.{letter}, 16-bit floating-point" in text
    assert "CHONA.Depth.Z, 32-bit floating-point" in text
    for name in ("Human", "Object", "Confidence"):
        assert f"CHONA.{name}.V, 16-bit floating-point" in text
    assert "scanlineimage" in text
    assert "zip" in text
    assert f'chona:model (type string): "{"a" * 64}"' in text
    assert "chona:frame (type int): -3" in text


@pytest.mark.parametrize("missing", [("depth",), ("human", "object"), ("confidence",), NAMES[1:]])
def test_passes_that_are_not_there_stay_so(tmp_path: Path, missing: tuple[str, ...]) -> None:
    path = tmp_path / "a.exr"
    layers = replace(_layers(5, 4), **dict.fromkeys(missing))
    write_frame(path, layers, HEADER)
    back, _ = read_frame(path)
    assert [name for name in NAMES if getattr(back, name) is None] == list(missing)
    assert back.passes == layers.passes
    assert is_finished(path, HEADER.model, HEADER.shot, layers.passes)
    assert not is_finished(path, HEADER.model, HEADER.shot)


def test_half_of_the_mattes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ExrError, match="both or none"):
        write_frame(tmp_path / "a.exr", replace(_layers(5, 4), human=None), HEADER)


def test_frames_from_before_passes_could_be_chosen_have_them_all(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_frame(path, _layers(5, 4), HEADER)
    with OpenEXR.File(str(path)) as file:
        header, channels = dict(file.header()), dict(file.channels())
    del header["chona:passes"]
    OpenEXR.File(header, {name: channel.pixels for name, channel in channels.items()}).write(str(path))
    assert is_finished(path, HEADER.model, HEADER.shot)
    assert read_frame(path)[0].passes == Passes()
    del channels["CHONA.Depth.Z"]
    OpenEXR.File(header, {name: channel.pixels for name, channel in channels.items()}).write(str(path))
    with pytest.raises(ExrError, match="passes combined,mattes,confidence, its header says combined,depth,"):
        read_frame(path)

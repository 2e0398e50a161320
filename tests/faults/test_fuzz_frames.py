"""Baked frames and stand-ins that are damaged or claim too much: refused, baked again, never half read."""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

from fuzzing import endured, start
from mutations import WORDS, npy, packed, spoiled_bytes, spoiled_npz

pytestmark = pytest.mark.faults
HEIGHT, WIDTH = 40, 20


def _frame(path: Path) -> bytes:
    from chona_model.cryptomatte import Mattes
    from chona_model.formats.exr import FrameHeader, FrameLayers, write_frame

    random = np.random.default_rng(0)
    shares = random.random((HEIGHT, WIDTH, 2)).astype(np.float32) * 0.5
    layers = FrameLayers(
        random.random((HEIGHT, WIDTH, 4)), np.full((HEIGHT, WIDTH), 2.5, np.float32),
        *random.random((3, HEIGHT, WIDTH)),
        np.zeros((HEIGHT, WIDTH, 3), np.float32), Mattes(("a.Sub01", "a.box01"), shares),
    )  # fmt: skip
    write_frame(path, layers, FrameHeader("a" * 64, "b" * 64, "final", "{}", 1.5, 3))
    return path.read_bytes()


def _attributes(content: bytes) -> list[tuple[int, int]]:
    """Where the values of a frame's attributes are: positions and sizes."""
    found, position = [], 8
    while content[position]:
        position = content.index(b"\0", content.index(b"\0", position) + 1) + 1
        (size,) = struct.unpack_from("<I", content, position)
        found.append((position + 4, size))
        position += 4 + size
    return found


@st.composite
def _spoiled_frame(draw: st.DrawFn, valid: bytes) -> bytes:
    """An attribute's size or value, the chunk table or a chunk's head changed; or any bytes."""
    if draw(st.booleans()):
        return draw(spoiled_bytes(valid))
    content, places = bytearray(valid), _attributes(valid)
    at, size = draw(st.sampled_from(places))
    table = places[-1][0] + places[-1][1] + 1
    kind = draw(st.integers(0, 3))
    word = draw(st.sampled_from(WORDS))
    if kind == 0:
        content[at - 4 : at] = struct.pack("<I", word & 0xFFFFFFFF)
    elif kind == 1:
        inside = at + 4 * draw(st.integers(0, max(size // 4 - 1, 0)))
        content[inside : inside + 4] = struct.pack("<I", word & 0xFFFFFFFF)
    elif kind == 2:
        entry = table + 8 * draw(st.integers(0, 2))
        content[entry : entry + 8] = struct.pack("<Q", word)
    else:
        (chunk,) = struct.unpack_from("<Q", valid, table)
        content[chunk + 4 : chunk + 8] = struct.pack("<I", word & 0xFFFFFFFF)
    return bytes(content)


def frames(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    """Our reader, the check whether a frame is up to date, and the add-on's reader of headers."""
    from chona_blender.exr_header import read_exr_header
    from chona_model.formats.exr import is_finished, read_frame
    from chona_model.formats.exr_structure import is_whole
    from chona_model.passes import Passes

    path = folder / "walk_0003.exr"
    valid = _frame(path)
    passes = Passes(normal=True, cryptomatte=True)
    assert is_finished(path, "a" * 64, "b" * 64, passes, ("a.Sub01", "a.box01"))

    def read(content: bytes) -> None:
        path.write_bytes(content)
        whole = is_whole(path)
        is_finished(path, "a" * 64, "b" * 64, passes, ("a.Sub01", "a.box01"))
        endured(lambda: read_exr_header(path))
        layers, _ = read_frame(path)
        assert whole, "a frame was read that is not whole"
        size = layers.combined.shape[:2]
        assert all(array.shape[:2] == size for array in (layers.depth, layers.human) if array is not None)

    return _spoiled_frame(valid), read


def stand_ins(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    """The add-on's reader of meshes."""
    from chona_blender.standin_file import read_stand_in
    from chona_model.skeleton import Skeleton
    from chona_model.standin.file import PartMesh, StandIn, write_stand_in

    path = folder / "robin.npz"
    faces, corners = np.array([[0, 1, 2]], np.int32), np.eye(3, dtype=np.float32)
    colours, bones = np.full((3, 3), 99, np.uint8), np.tile(np.array([[0, 1, -1, -1]], np.int16), (3, 1))
    weights = np.tile(np.array([[0.5, 0.5, 0, 0]], np.float32), (3, 1))
    parts = (
        PartMesh("person", "Sub01", corners, faces, corners, colours, bones, weights),
        PartMesh("object", "box01", corners, faces, corners, colours, None, None),
    )
    write_stand_in(path, StandIn(Skeleton(("hips", "head"), (-1, 0)), np.zeros((2, 3)), "0" * 64, 0.01, 0.5, parts))
    with np.load(path) as content:
        valid = {name: content[name] for name in content.files}

    def read(content: bytes) -> None:
        path.write_bytes(content)
        for part in read_stand_in(path, 2):
            assert np.isfinite(part.vertices).all() and part.faces.max(initial=-1) < len(part.vertices)
            part.name.encode()

    read(path.read_bytes())
    return spoiled_npz(valid, "header"), read


@pytest.mark.parametrize(("family", "few"), [("frames", 80), ("stand_ins", 60)])
def test_spoiled_frames_and_stand_ins_are_refused_or_read_whole(tmp_path: Path, often, family: str, few: int) -> None:
    report = start("test_fuzz_frames", family, often(few, 10_000), tmp_path)
    assert f"{family}: 0 refused" not in report


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return _frame(tmp_path_factory.mktemp("frames") / "a.exr")


def _window(content: bytes, *window: int) -> bytes:
    place = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    return content[:place] + struct.pack("<4i", *window) + content[place + 16 :]


@pytest.mark.parametrize(
    ("window", "message"),
    [((0, 0, (1 << 31) - 1, 39), "data window"), ((0, 0, 19, (1 << 31) - 1), "data window"),
     ((-(1 << 31), 0, (1 << 31) - 1, 0), "data window"), ((0, 0, 65535, 65535), "cut off|bytes a line|unpack")],
)  # fmt: skip
def test_a_header_that_claims_a_huge_picture_asks_for_no_memory(tmp_path: Path, whole: bytes, window, message) -> None:
    from chona_model.formats.exr import read_frame
    from chona_model.formats.exr_structure import ExrError

    path = tmp_path / "a.exr"
    path.write_bytes(_window(whole, *window))
    with pytest.raises(ExrError, match=message):
        read_frame(path)


def test_one_chunk_is_not_unpacked_for_every_line(tmp_path: Path, whole: bytes) -> None:
    """A table of a thousand places that all name the same chunk would take minutes."""
    from chona_model.formats.exr_structure import ExrError, check_exr

    end = _attributes(whole)[-1]
    table = sum(end) + 1
    first = struct.unpack_from("<Q", whole, table)[0]
    path = tmp_path / "a.exr"
    path.write_bytes(whole[:table] + struct.pack("<Q", first) * 3 + whole[table + 24 :])
    with pytest.raises(ExrError, match="overlaps"):
        check_exr(path)


def test_a_stand_ins_nested_array_header_is_no_lack_of_memory(tmp_path: Path) -> None:
    from chona_blender.errors import ChonaError
    from chona_blender.standin_file import read_stand_in

    path = tmp_path / "a.npz"
    path.write_bytes(packed({"header": npy("-" * 9000 + "1", "()")}))
    with pytest.raises(ChonaError, match="an array without the header that numpy writes") as caught:
        read_stand_in(path, 2)
    assert not isinstance(caught.value.__cause__, MemoryError)


def test_a_stand_in_bomb_is_refused(tmp_path: Path) -> None:
    from chona_blender.errors import ChonaError
    from chona_blender.standin_file import read_stand_in

    header = json.dumps({"format": "chona-stand-in", "version": 1, "parts": []}).encode()
    bomb = npy("'<f4'", "(80000000,)", bytes(320_000_000))
    path = tmp_path / "a.npz"
    path.write_bytes(packed({"header": npy("'|u1'", f"({len(header)},)", header), "part.0.vertices": bomb}))
    with pytest.raises(ChonaError, match="unpacks to"):
        read_stand_in(path, 2)

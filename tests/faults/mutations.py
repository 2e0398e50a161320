"""Hypothesis strategies that spoil valid input: bytes, JSON, arrays, pickles and safetensors files."""

from __future__ import annotations

import copy
import io
import json
import math
import pickle
import struct
import zipfile
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from hypothesis import strategies as st

DEEP = 100_000
WORDS = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    1 << 40,
    (1 << 63) - 1,
    (1 << 64) - 1,
)
NUMBERS = (0, 1, -1, 2, 3, 255, -(1 << 31), 1 << 31, 1 << 40, 1 << 63, 1 << 64, 10**30, 0.5, -0.0, 1e-300,
           1e9, 1e30, 1e308,
           math.nan, math.inf, -math.inf)  # fmt: skip
TEXTS = ("", ".", "..", "../../../etc/passwd", "/etc/passwd", "..\\..\\x", "C:\\x",
         "\0", "a\nb", "%s%n%d", "$(touch owned)",
         "; rm -rf x", "ü漢字😀", "x" * 300, "x" * 70_000, "\ud800", "NaN", "1e999",
         "__metadata__", "person.Sub01.skin")  # fmt: skip


def deep_json(depth: int = DEEP) -> str:
    """A list in a list in a list …"""
    return "[" * depth + "]" * depth


hostile = st.one_of(
    st.sampled_from(NUMBERS), st.sampled_from(TEXTS), st.none(), st.booleans(), st.just([]), st.just({}),
    st.builds(lambda n: [0.0] * n, st.integers(0, 300)), st.builds(lambda n: [[1]] * n, st.integers(0, 20)),
    st.just({"a": {"b": [1]}}), st.integers(), st.floats(), st.text(max_size=20),
)  # fmt: skip
"""Values of a type, size or content that nobody expects."""


@st.composite
def spoiled_bytes(draw: st.DrawFn, valid: bytes) -> bytes:
    """Cut off, bits turned, words replaced by extreme ones, pieces left out, doubled or made up."""
    content = bytearray(valid)
    for _ in range(draw(st.integers(1, 4))):
        if not content:
            return bytes(content)
        # Beginnings matter most: that is where headers are.
        at = draw(st.integers(0, len(content) - 1) | st.integers(0, min(len(content), 256) - 1))
        kind = draw(st.integers(0, 6))
        if kind == 0:
            del content[at:]
        elif kind == 1:
            content[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == 2:
            size = draw(st.sampled_from((1, 2, 4, 8)))
            word = draw(st.sampled_from(WORDS)) & ((1 << 8 * size) - 1)
            content[at : at + size] = word.to_bytes(size, draw(st.sampled_from(("little", "big"))))
        elif kind == 3:
            del content[at : at + draw(st.integers(1, 64))]
        elif kind == 4:
            content[at:at] = content[at : at + draw(st.integers(1, 64))]
        elif kind == 5:
            content[at:at] = draw(st.binary(min_size=1, max_size=24))
        else:
            content += draw(st.binary(min_size=1, max_size=24))
    return bytes(content)


@st.composite
def spoiled_tree(draw: st.DrawFn, valid: Any) -> Any:
    """A value somewhere in nested dicts and lists replaced, left out, doubled, renamed or wrapped."""
    content = copy.deepcopy(valid)
    for _ in range(draw(st.integers(1, 3))):
        holder, key, node = None, None, content
        while isinstance(node, dict | list) and node and (holder is None or draw(st.integers(0, 4))):
            keys = list(node) if isinstance(node, dict) else range(len(node))
            holder, key = node, keys[draw(st.integers(0, len(keys) - 1))]
            node = node[key]
        kind = draw(st.integers(0, 5))
        value = copy.deepcopy(draw(hostile))
        if holder is None:
            content = value
        elif kind <= 2:
            holder[key] = value
        elif kind == 3:
            del holder[key]
        elif kind == 4 and isinstance(holder, dict):
            holder[str(value)[:400]] = holder.pop(key)
        elif isinstance(holder, list):
            holder.insert(key, value)
        else:
            holder[key] = [node]
    return content


def spoiled_json(valid: Any) -> st.SearchStrategy[bytes]:
    """JSON of another form, damaged, or nested deeper than any parser goes."""
    text = json.dumps(valid).encode()
    return st.one_of(
        spoiled_tree(valid).map(lambda tree: json.dumps(tree).encode()),
        spoiled_tree(valid).map(lambda tree: json.dumps(tree).encode()),
        spoiled_bytes(text), st.just(deep_json().encode()), st.just(b'{"a":' * DEEP),
        st.just(b"1" * 6000), st.just(b""),
    )  # fmt: skip


@st.composite
def spoiled_array(draw: st.DrawFn, valid: np.ndarray) -> Any:
    """Another type, shape or content."""
    kind = draw(st.integers(0, 5))
    if kind == 0 and valid.size and valid.dtype.kind in "fc":
        array = valid.copy()
        flat = array.reshape(-1)
        with np.errstate(over="ignore"):
            flat[draw(st.integers(0, flat.size - 1))] = float(draw(st.sampled_from(NUMBERS)))
        return array
    if kind == 0 and valid.size and valid.dtype.kind in "iu":
        array = valid.copy()
        info = np.iinfo(array.dtype)
        array.reshape(-1)[draw(st.integers(0, array.size - 1))] = draw(st.sampled_from((info.min, info.max, 0)))
        return array
    if kind == 1:
        name = draw(
            st.sampled_from(("f2", "f4", "f8", "i1", "u1", "i4", "u8", "?", "c16", "U3", "S2", "O", "M8[s]", ">f8"))
        )
        try:
            return valid.astype(name)
        except (TypeError, ValueError):
            return np.zeros(valid.shape, dtype=name)
    if kind == 2:
        shape = list(valid.shape)
        if shape:
            shape[draw(st.integers(0, len(shape) - 1))] = draw(st.integers(0, 5))
        return np.resize(valid, shape) if valid.size else np.zeros(shape, valid.dtype)
    if kind == 3:
        return draw(
            st.sampled_from(
                (valid[None], valid.reshape(-1), valid.T, np.zeros(0), np.array(1.5), valid.reshape(-1)[:1])
            )
        )
    if kind == 4:
        return (
            np.full_like(valid, draw(st.sampled_from((0, 1, -1, 3))))
            if valid.dtype.kind == "f"
            else np.zeros_like(valid)
        )
    return np.zeros((0, *valid.shape), dtype=valid.dtype)


def npy(descr: str, shape: str, content: bytes = b"", order: str = "False") -> bytes:
    """A .npy with a header of the caller's own."""
    header = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + content


odd_npy = st.builds(
    npy,
    st.sampled_from(
        ("'<f8'", "'|O'", "'<U9'", "[('a', '<f8')]", "'V100'", "'<f99'", "'|u1'", "-" * 9000 + "1", "(" * 5000)
    ),
    st.sampled_from(
        ("(1000000000000,)", "(-1,)", "(0, 9999999999999)", "(2, 2)", "()", "5", "(" * 900, "(1e9,)", "(True,)")
    ),
    st.binary(max_size=40),
)
"""Arrays whose headers claim what is not there."""


def packed(members: Mapping[str, bytes], compress: bool = True) -> bytes:
    """An .npz of members as they are."""
    stream = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with zipfile.ZipFile(stream, "w", kind) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


def npy_bytes(array: np.ndarray) -> bytes:
    """An array as ``numpy.save`` writes it, objects pickled."""
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


@st.composite
def spoiled_npz(draw: st.DrawFn, valid: Mapping[str, np.ndarray], header: str | None = None) -> bytes:
    """Arrays spoiled, missing, doubled or renamed; the JSON of the one called ``header`` spoiled; the zip damaged."""
    members = {name: npy_bytes(array) for name, array in valid.items()}
    kind = draw(st.integers(0, 9))
    if kind <= 2 and header is not None:
        text = draw(spoiled_json(json.loads(valid[header].tobytes())))
        members[header] = npy_bytes(np.frombuffer(text, dtype=np.uint8))
    elif kind <= 6:
        for _ in range(draw(st.integers(1, 2))):
            name = draw(st.sampled_from(sorted(valid)))
            if draw(st.integers(0, 5)) == 0:
                members.pop(name, None)
            elif draw(st.integers(0, 3)) == 0:
                members[name] = draw(odd_npy | spoiled_bytes(npy_bytes(valid[name])))
            else:
                members[name] = npy_bytes(np.asarray(draw(spoiled_array(valid[name]))))
    content = packed(members, draw(st.booleans()))
    return content if kind < 8 else draw(spoiled_bytes(content))


class Attack:
    """Unpickled by pickle itself, it makes a file."""

    def __init__(self, mark: str) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return open, (self.mark, "w")


def laughs(depth: int = 60) -> Any:
    """A key whose hash takes 2 to the 60 steps."""
    key: Any = ()
    for _ in range(depth):
        key = (key, key)
    return key


def hand_written(mark: str) -> tuple[bytes, ...]:
    """Pickles that no pickler writes: memory asked for, keys without end, nesting, code."""
    doubled = b"\x80\x04)" + b"\x94h\x00h\x00\x86" + b"".join(b"\x94h%c\x68%c\x86" % (n, n) for n in range(1, 60))
    return (
        b"\x80\x04\x8e" + struct.pack("<Q", 1 << 40) + b"x.",
        b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b"x.",
        b"\x80\x04Nr" + struct.pack("<I", 0x7FFFFFFF) + b".",
        b"\x80\x04}(" + doubled[2:] + b"K\x01u.", b"\x80\x04\x8f(" + doubled[2:] + b"\x90.",
        b"(" + doubled[2:] + b"K\x01d.",
        b"\x80\x04" + b"]" * DEEP + b"a" * (DEEP - 1) + b".", b"\x80\x04" + b"(" * DEEP + b".",
        f"cbuiltins\nopen\n(S'{mark}'\nS'w'\ntR.".encode(),
        f"c__builtin__\neval\n(S'open(\"{mark}\",\"w\")'\ntR.".encode(),
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR(I1\n(I9999999999\ntcnumpy\ndtype\n"
        b"(S'f8'\nI0\nI1\ntRI00\nS''\ntb.",
        b"\x80\x04c__builtin__\nbytes\n\x8a\x05\x00\x00\x00\x00\x10\x85R.", b"c__builtin__\nset\n(]tR(N}S'x'\nI1\nstb.",
        b"c_codecs\nencode\n(N}S'__defaults__'\n(S'utf8'\ntstb.",
    )  # fmt: skip


@st.composite
def spoiled_pickle(draw: st.DrawFn, valid: Any, mark: str, npy_of_object: bool = False) -> bytes:
    """A pickle, or a .npy of one object, with a tree, an array or bytes spoiled, or with code in it."""
    kind = draw(st.integers(0, 9))
    if kind == 0:
        return draw(st.sampled_from(hand_written(mark)))
    content: Any = valid
    if kind <= 4:
        content = draw(spoiled_tree(valid))
    elif kind <= 7 and isinstance(valid, dict):
        content = dict(valid)
        name = draw(st.sampled_from(sorted(content)))
        content[name] = draw(spoiled_array(np.asarray(content[name]))) if kind < 7 else Attack(mark)
    if npy_of_object:
        holder = np.empty((), dtype=object)
        holder[()] = content
        data = npy_bytes(holder)
    else:
        data = pickle.dumps(content, protocol=draw(st.integers(0, 5)))
    return data if kind < 9 else draw(spoiled_bytes(data))


def split_safetensors(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Header and data."""
    (length,) = struct.unpack("<Q", content[:8])
    return json.loads(content[8 : 8 + length]), content[8 + length :]


def join_safetensors(header: Any, data: bytes) -> bytes:
    """Whatever the header is."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


@st.composite
def spoiled_safetensors(draw: st.DrawFn, valid: bytes, entries: tuple[str, ...]) -> bytes:
    """The header, one of the JSON texts in its metadata, a tensor's description, or bytes spoiled.

    Args:
        entries: of the metadata, each a JSON text.
    """
    header, data = split_safetensors(valid)
    kind = draw(st.integers(0, 9))
    if kind <= 4:
        name = draw(st.sampled_from(entries))
        text = draw(spoiled_json(json.loads(header["__metadata__"][name])))
        header["__metadata__"][name] = text.decode("utf-8", errors="replace")
        return join_safetensors(header, data)
    if kind == 5:
        return join_safetensors(draw(spoiled_tree(header)), data)
    if kind == 6:
        return join_safetensors(draw(spoiled_json(header)), data)
    if kind == 7:  # one tensor described anew: its name, type, shape or place
        name = draw(st.sampled_from(sorted(set(header) - {"__metadata__"})))
        header[name] = draw(spoiled_tree(header[name]))
        return join_safetensors(header, data)
    if kind == 8:  # numbers of a tensor
        spoiled = bytearray(data)
        at = draw(st.integers(0, max(len(data) // 4 - 1, 0)))
        spoiled[4 * at : 4 * at + 4] = draw(
            st.sampled_from((b"\0\0\xc0\x7f", b"\0\0\x80\x7f", b"\xff\xff\xff\xff", b"\0\0\0\x80"))
        )
        return join_safetensors(header, bytes(spoiled))
    return draw(spoiled_bytes(valid))

"""Arrays of .npz files from outside: every size is known and bounded before memory is asked for, nothing is run.

numpy's own reader believes an array's header: a few hundred bytes ask it for a terabyte.  What is read here is what
``numpy.savez`` writes of numbers; Python objects, structures and texts are refused.
"""

from __future__ import annotations

import math
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from chona_model.plain_json import shortened

MOST_BYTES = 1 << 28
"""Of all arrays together, where they are packed; files that are not may be as large as they are."""

MOST_DIMENSIONS = 16
_MAGIC = b"\x93NUMPY"
_HEADER = re.compile(
    rb"\{'descr': '([<>|=]?[?biufc]\d{0,2})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,19}L?, ?)*\d{0,19}L?)\),? ?\} *\n?"
)


class ArraysError(ValueError):
    """A file that holds no arrays of numbers, or not all of what it announces."""


def read_arrays(source: Path | BinaryIO, names: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """Arrays by name.

    Args:
        names: those that are wanted, the others are not looked at; all when None.

    Raises:
        ArraysError: a wanted array is missing, damaged, no plain array of numbers or larger than ``MOST_BYTES`` and the
            file itself; or the file is no .npz.  OSError: it cannot be read.
    """
    try:
        with zipfile.ZipFile(source) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            missing = [name for name in names or () if name not in members]
            if missing:
                raise ArraysError(f"there is no array '{missing[0]}'")
            left = max(_size(source), MOST_BYTES)
            arrays: dict[str, np.ndarray] = {}
            for name in members if names is None else names:
                arrays[name] = _read(archive, members[name], left)
                left -= arrays[name].nbytes
            return arrays
    except (
        zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, RuntimeError, OverflowError,
        ValueError, MemoryError,
    ) as error:  # fmt: skip
        raise ArraysError(shortened(error)) from error


def _size(source: Path | BinaryIO) -> int:
    return source.stat().st_size if isinstance(source, Path) else source.seek(0, os.SEEK_END)


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo, most: int) -> np.ndarray:
    name = shortened(info.filename)
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or info.flag_bits & 1:
        raise ArraysError(f"'{name}' is packed in a way that numpy does not pack")
    with archive.open(info) as file:
        start = file.read(len(_MAGIC) + 2)
        wide = start[-2:-1] in (b"\2", b"\3")
        if start[:-2] != _MAGIC or not (wide or start[-2:-1] == b"\1"):
            raise ArraysError(f"'{name}' is no array")
        (length,) = struct.unpack("<I" if wide else "<H", file.read(4 if wide else 2))
        header = _HEADER.fullmatch(file.read(min(length, 1 << 12)))
        if header is None:
            raise ArraysError(f"'{name}' is no plain array of numbers")
        try:
            dtype = np.dtype(header[1].decode())
        except TypeError as error:
            raise ArraysError(f"'{name}' has numbers of the unknown type {header[1].decode()}") from error
        shape = tuple(int(part.strip(b" L")) for part in header[3].split(b",") if part.strip())
        count = math.prod(shape) * dtype.itemsize if len(shape) <= MOST_DIMENSIONS else most + 1
        if count > most:
            raise ArraysError(f"'{name}' has the shape {list(shape)[:MOST_DIMENSIONS]}, more than {most} bytes")
        content = file.read(count + 1)
        if len(content) != count:
            raise ArraysError(f"'{name}' has other than the {count} bytes of its shape {list(shape)}")
    order: Any = "F" if header[2] == b"True" else "C"
    return np.frombuffer(content, dtype=dtype).reshape(shape, order=order).astype(dtype.newbyteorder("="))

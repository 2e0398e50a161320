"""Whether an EXR file is whole, and its text attributes, with the standard library alone.

OpenEXR's own reader prints to the process's streams when a file is damaged, which would land among progress lines;
this reads the little that is needed of single-part scanline files: attributes, and every chunk's zlib checksum.
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_MAGIC = b"\x76\x2f\x31\x01"
_LINES_PER_CHUNK = {0: 1, 2: 1, 3: 16}
"""Compression (none, ZIPS, ZIP) to lines a chunk."""
_BYTES = {0: 4, 1: 2, 2: 4}
"""Channel type (uint, half, float) to bytes."""
_MOST_SIDE = 65536
_MOST_CHUNK = 1 << 28
"""Bytes of a chunk when unpacked: 16 lines of 65536 pixels with 60 channels."""
_MOST_HEADER = 1 << 20
"""Bytes, a Cryptomatte's names included."""


class ExrError(ValueError):
    """An EXR file that is damaged or not one of this program's, or pixels that must not become one."""


@dataclass(frozen=True)
class Structure:
    """What a whole file's header says.

    Attributes:
        width, height: pixels.
        channels: names as stored, with their layer.
        attributes: raw bytes by name, of all attributes.
    """

    width: int
    height: int
    channels: tuple[str, ...]
    attributes: dict[str, bytes]

    def text(self, name: str) -> str | None:
        """A text attribute, or None."""
        value = self.attributes.get(name)
        return None if value is None else value.decode("utf-8", errors="replace")


def check_exr(path: Path) -> Structure:
    """Reads a single-part scanline EXR (uncompressed or zlib) and checks that every line of it is there and intact.

    Raises:
        ExrError: the file is missing, truncated, damaged, or of another kind.
    """
    try:
        with path.open("rb") as file:
            structure, start, line_bytes, compression = _header(file.read(_MOST_HEADER))
            _check_chunks(file, start, structure.height, line_bytes, compression)
            return structure
    except (OSError, ValueError, IndexError, KeyError, struct.error, zlib.error) as error:
        raise ExrError(f"{path} is no complete scanline EXR: {error}; render it again") from error


def is_whole(path: Path) -> bool:
    """Whether there is a file, and all of it."""
    try:
        check_exr(path)
    except ExrError:
        return False
    return True


def _header(content: bytes) -> tuple[Structure, int, int, int]:
    if content[:4] != _MAGIC:
        raise ValueError("it does not start as an EXR file")
    if struct.unpack_from("<I", content, 4)[0] & 0x1A00:
        raise ValueError("it is tiled, deep or multi-part")
    attributes, position = {}, 8
    while content[position] != 0:
        name, position = _name(content, position)
        _, position = _name(content, position)
        (size,) = struct.unpack_from("<I", content, position)
        value = content[position + 4 : position + 4 + size]
        if len(value) != size:
            raise ValueError("its header is cut off")
        attributes[name] = value
        position += 4 + size
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    names, pixel_bytes, channels = [], 0, attributes["channels"]
    cursor = 0
    while channels[cursor] != 0:
        name, cursor = _name(channels, cursor)
        pixel_bytes += _BYTES[struct.unpack_from("<i", channels, cursor)[0]]
        names.append(name)
        cursor += 16
    if not (1 <= width <= _MOST_SIDE and 1 <= height <= _MOST_SIDE):
        raise ValueError(f"its data window is {width}x{height}")
    return (
        Structure(width, height, tuple(names), attributes),
        position + 1,
        width * pixel_bytes,
        attributes["compression"][0],
    )


def _check_chunks(file: BinaryIO, table: int, height: int, line_bytes: int, compression: int) -> None:
    lines = _LINES_PER_CHUNK[compression]
    count = -(-height // lines)
    if line_bytes * lines > _MOST_CHUNK:
        raise ValueError(f"it claims {line_bytes} bytes a line")
    length = os.fstat(file.fileno()).st_size
    file.seek(table)
    offsets = struct.unpack(f"<{count}Q", file.read(8 * count))
    free = table + 8 * count  # chunks follow the table and one another: none is counted, or unpacked, twice
    for index, offset in enumerate(offsets):
        if not free <= offset <= length - 8:
            raise ValueError(f"chunk {index} of {count} is cut off, or overlaps what is before it")
        file.seek(offset)
        _, size = struct.unpack("<iI", file.read(8))
        free = offset + 8 + size
        expected = line_bytes * min(lines, height - index * lines)
        if free > length or size > expected:
            raise ValueError(f"chunk {index} of {count} is cut off")
        if size != expected and (compression == 0 or not _unpacks_to(file.read(size), expected)):
            raise ValueError(f"chunk {index} of {count} has the wrong length")


def _unpacks_to(packed: bytes, expected: int) -> bool:
    """Whether zlib data are whole and so many bytes; never unpacks more."""
    stream = zlib.decompressobj()
    return len(stream.decompress(packed, expected + 1)) == expected and stream.eof


def _name(content: bytes, position: int) -> tuple[str, int]:
    end = content.find(b"\0", position, position + 256)
    if end < 0:
        raise ValueError("a name in its header has no end")
    return content[position:end].decode("utf-8"), end + 1

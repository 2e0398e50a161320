"""The header of an OpenEXR file, read with the standard library alone.

Blender's Python has no OpenEXR reader and a multilayer image's size is (0, 0) until it is drawn, so the size of a
baked frame, its layers and the settings it was made with are taken from the file itself. Only the first few kilobytes
are read.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path

from .errors import ChonaError

MAGIC = b"\x76\x2f\x31\x01"
HEADER_LIMIT = 1 << 20


@dataclass(frozen=True)
class ExrHeader:
    """What the add-on needs to know of an EXR file."""

    width: int
    height: int
    channels: tuple[str, ...]
    strings: dict[str, str] = field(default_factory=dict)

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of the layers that have a Combined pass, in alphabetical order."""
        return tuple(sorted({name.split(".")[0] for name in self.channels if ".Combined." in name}))


def read_exr_header(path: Path) -> ExrHeader:
    """Read the header of a single-part EXR file, or say why it cannot be used."""
    try:
        with path.open("rb") as file:
            data = file.read(HEADER_LIMIT)
    except OSError as error:
        raise ChonaError(f"cannot read {path}: {error.strerror or error}") from error
    if data[:4] != MAGIC:
        raise ChonaError(f"{path} is not an OpenEXR file; expected a frame that `chona bake` wrote; bake it again")
    try:
        return _parse(data)
    except (IndexError, ValueError, KeyError, struct.error) as error:
        raise ChonaError(f"the header of {path} is damaged; bake the frame again with Overwrite on") from error


def _parse(data: bytes) -> ExrHeader:
    position = 8
    window: tuple[int, int, int, int] | None = None
    channels: tuple[str, ...] = ()
    strings: dict[str, str] = {}
    while data[position] != 0:
        name, position = _text(data, position)
        kind, position = _text(data, position)
        (size,) = struct.unpack_from("<i", data, position)
        position += 4
        if size < 0 or position + size > len(data):
            raise ValueError(name)
        value = data[position : position + size]
        position += size
        if name == "dataWindow":
            window = struct.unpack("<4i", value)
        elif name == "channels":
            channels = _channel_names(value)
        elif kind == "string":
            strings[name] = value.decode("utf-8", errors="replace")
    if window is None:
        raise KeyError("dataWindow")
    return ExrHeader(window[2] - window[0] + 1, window[3] - window[1] + 1, channels, strings)


def _text(data: bytes, position: int) -> tuple[str, int]:
    """A null-terminated text and the position behind it."""
    end = data.index(0, position)
    return data[position:end].decode("utf-8", errors="replace"), end + 1


def _channel_names(value: bytes) -> tuple[str, ...]:
    """Each channel: its name, then 16 bytes of type, linearity and sampling."""
    names: list[str] = []
    position = 0
    while value[position] != 0:
        name, position = _text(value, position)
        names.append(name)
        position += 16
    return tuple(names)

"""Stand-ins that the worker wrote (docs/file-formats.md), with numpy alone."""

from __future__ import annotations

import json
import math
import struct
import tokenize
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from .errors import ChonaError

FORMAT, VERSION = "chona-stand-in", 1
MOST_BYTES = 1 << 28
"""Of all arrays together, where the file itself is not larger: more is damage or an attack and never asked for."""

MOST_HEADER = 1 << 24
LONGEST_ARRAY_HEADER = 512
"""Characters: ten thousand that are nested make Python say that there is no memory."""
LONGEST = 200
"""Characters of an error's words: some repeat the file."""

WEIGHT_SUM_ERROR = 1e-3

DAMAGE = (
    OSError, zipfile.BadZipFile, zlib.error, struct.error, ValueError, KeyError, TypeError, AttributeError, EOFError,
    OverflowError, RecursionError, NotImplementedError, RuntimeError, MemoryError, SyntaxError, tokenize.TokenError,
)  # fmt: skip
"""What damaged zip files, arrays and JSON end in."""


@dataclass(frozen=True)
class PartMesh:
    """The mesh of a person (canonical space: T-pose, y up, metres) or of an object (its own frame, metres).

    Attributes:
        kind: ``person`` or ``object``; name: of the identity.
        vertices: [V, 3]; faces: [F, 3] counter-clockwise from outside.
        colours: [V, 3] uint8 sRGB.
        bones: [V, 4] model bones, −1 for none; weights: [V, 4]; both [V, 0] for an object.
    """

    kind: str
    name: str
    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    bones: np.ndarray
    weights: np.ndarray


def read_stand_in(path: Path, bones: int) -> tuple[PartMesh, ...]:
    """Reads and checks a stand-in's meshes.

    Args:
        bones: of the model's skeleton, B.

    Raises:
        ChonaError: missing, damaged, of another version, or with contents that contradict each other.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if archive.getinfo("header.npy").file_size > MOST_HEADER:
                raise ValueError(f"its header has more than {MOST_HEADER} bytes")
            claimed = sum(member.file_size for member in archive.infolist())
            if claimed > max(MOST_BYTES, path.stat().st_size):
                raise ValueError(f"it unpacks to {claimed} bytes, more than {MOST_BYTES}")
            header = json.loads(_array(archive, "header", np.uint8, (None,)).tobytes())
            json.dumps(header, ensure_ascii=False).encode()  # half a surrogate pair passes the parser
            if header.get("format") != FORMAT or header.get("version") != VERSION:
                found, version = (str(header.get(name))[:LONGEST] for name in ("format", "version"))
                raise ChonaError(
                    f"{path} is a {found!r} of version {version}, expected a {FORMAT!r} "
                    f"of version {VERSION}; install the CHONA extension again, so that add-on and worker match"
                )
            return tuple(_part(archive, index, each, bones) for index, each in enumerate(header["parts"]))
    except DAMAGE as error:
        words = f"{type(error).__name__}: {str(error)[:LONGEST]}"
        raise ChonaError(f"the stand-in {path} cannot be read ({words}); make it again") from error


def _part(archive: zipfile.ZipFile, index: int, described: dict[str, Any], bones: int) -> PartMesh:
    count, triangles = int(described["vertices"]), int(described["faces"])

    def array(name: str, kind: type, width: int, rows: int = count) -> np.ndarray:
        return _array(archive, f"part.{index}.{name}", kind, (rows, width))

    is_person = described["kind"] == "person"
    part = PartMesh(
        str(described["kind"]), str(described["name"]),
        array("vertices", np.float32, 3).astype(np.float64), array("faces", np.int32, 3, triangles),
        array("colours", np.uint8, 3),
        array("bones", np.int16, 4) if is_person else np.zeros((count, 0), np.int16),
        array("weights", np.float32, 4).astype(np.float64) if is_person else np.zeros((count, 0)),
    )  # fmt: skip
    if not np.isfinite(part.vertices).all() or not np.isfinite(part.weights).all():
        raise ValueError(f"'{part.name}' has numbers that are not finite")
    if triangles and not (part.faces.min() >= 0 and part.faces.max() < count):
        raise ValueError(f"faces of '{part.name}' name vertices that are not there")
    if is_person and count and not (part.bones.min() >= -1 and part.bones.max() < bones):
        raise ValueError(f"'{part.name}' names bones beyond the skeleton's {bones}")
    if is_person and np.abs(np.where(part.bones >= 0, part.weights, 0.0).sum(axis=1) - 1.0).max() > WEIGHT_SUM_ERROR:
        raise ValueError(f"weights of '{part.name}' do not sum to one")
    return part


def _array(archive: zipfile.ZipFile, name: str, kind: type, shape: tuple[int | None, ...]) -> np.ndarray:
    """An array whose size is known before any of it is read."""
    with archive.open(f"{name}.npy") as file:
        found, _, dtype = _npy_header(file)
    fits = len(found) == len(shape) and all(want in (None, have) for want, have in zip(shape, found, strict=True))
    if dtype != np.dtype(kind) or not fits:
        raise ValueError(f"'{name}' is {dtype} {list(found)}, expected {np.dtype(kind)} {list(shape)}")
    size = archive.getinfo(f"{name}.npy").file_size
    if math.prod(found) * dtype.itemsize > size:
        raise ValueError(f"'{name}' has {list(found)} numbers in {size} bytes")
    with archive.open(f"{name}.npy") as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _npy_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"an array of numpy's format {version}, expected (1, 0)")
    try:
        return np.lib.format.read_array_header_1_0(file, max_header_size=LONGEST_ARRAY_HEADER)
    except ValueError as error:
        raise ValueError("an array without the header that numpy writes") from error

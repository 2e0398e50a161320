"""Extents of BEHAVE's objects from their template meshes, read with a few lines of OBJ and PLY."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from chona_model.data.dataset import DatasetError, ObjectShape
from chona_model.plain_json import read_text, shortened

DEFAULT_HALF_EXTENT = 0.6
"""Metres; half the box of an object without a template (the largest of BEHAVE's 20 objects reaches 0.6 m)."""

MOST_BYTES = 1 << 29
"""Of a template or point cloud (CO3D's have up to 100 MB)."""

MOST_HEADER = 1 << 16
FARTHEST = 1e9
"""Of a vertex from the origin, in the file's own unit."""

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


def read_object_shape(folder: Path, name: str, gaps: Counter[str]) -> ObjectShape:
    """The box of an object around the mean vertex of its simplified template.

    Without a simplified template the fits' origin is unknown: the scan's mean vertex is taken instead and its box
    doubled.  Without any template the box is ``DEFAULT_HALF_EXTENT`` to every side.  Both are counted in ``gaps``.

    Raises:
        DatasetError: a template is damaged.
    """
    simplified = sorted(
        (path for path in folder.glob("*.ply") if re.search(r"_f\d+$", path.stem)),
        key=lambda path: (re.sub(r"_f\d+$", "", path.stem) != name, path.name),
    )
    scan = folder / f"{name}.obj"
    if not simplified and not scan.is_file():
        gaps["object template"] += 1
        return ObjectShape(name, np.full(3, -DEFAULT_HALF_EXTENT), np.full(3, DEFAULT_HALF_EXTENT))
    if not simplified:
        gaps["simplified object template"] += 1
        vertices = read_obj_vertices(scan)
        low, high = vertices.min(0) - vertices.mean(0), vertices.max(0) - vertices.mean(0)
        return ObjectShape(name, 2.0 * low, 2.0 * high)
    coarse = read_ply_vertices(simplified[0])
    centre = coarse.mean(0)
    lower, upper = coarse.min(0) - centre, coarse.max(0) - centre
    if scan.is_file():
        # Decimation cuts corners off; the scan counts where it is the same object in the same place.
        full = read_obj_vertices(scan)
        low, high = full.min(0) - centre, full.max(0) - centre
        if max(np.abs(low - lower).max(), np.abs(high - upper).max()) < 0.2 * np.linalg.norm(upper - lower):
            lower, upper = np.minimum(lower, low), np.maximum(upper, high)
        else:
            gaps["object scan (elsewhere than its simplified template)"] += 1
    return ObjectShape(name, lower, upper)


def read_obj_vertices(path: Path) -> np.ndarray:
    """[V, 3] vertices of a Wavefront OBJ."""
    try:
        text = read_text(path, MOST_BYTES).decode("latin1")
        lines = [line.split()[1:4] for line in text.splitlines() if line.startswith("v ")]
        vertices = np.array(lines, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise DatasetError(
            f"cannot read the object template {path}: {shortened(error)}; expected a Wavefront OBJ"
        ) from error
    return _checked(vertices, path)


def read_ply_vertices(path: Path) -> np.ndarray:
    """[V, 3] vertices of a PLY, ASCII or binary, whose first element is the vertices."""
    try:
        content = read_text(path, MOST_BYTES)
        end = content.index(b"end_header\n", 0, MOST_HEADER) + len(b"end_header\n")
        words = [line.split() for line in content[:end].decode("ascii").splitlines()]
        kind = next(word[1] for word in words if word[:1] == ["format"])
        starts = [index for index, word in enumerate(words) if word[:1] == ["element"]]
        if words[starts[0]][1] != "vertex":
            raise ValueError("the first element is not 'vertex'")
        count = int(words[starts[0]][2])
        stop = starts[1] if len(starts) > 1 else len(words)
        fields = [(word[2], word[1]) for word in words[starts[0] : stop] if word[:1] == ["property"]]
        columns = [[name for name, _ in fields].index(axis) for axis in "xyz"]
        if kind == "ascii":
            rows = content[end:].decode("ascii").splitlines()[:count]
            table = np.array([row.split()[: len(fields)] for row in rows], dtype=np.float64)
            vertices = table.reshape(count, len(fields))[:, columns]
        else:
            order = ">" if "big" in kind else "<"
            dtype = np.dtype([(name, order + _PLY_TYPES[letter]) for name, letter in fields])
            records = np.frombuffer(content, dtype=dtype, count=count, offset=end)
            vertices = np.stack([records[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    except (OSError, ValueError, KeyError, IndexError, StopIteration, OverflowError, MemoryError) as error:
        told = f"{type(error).__name__} {shortened(error)}"
        raise DatasetError(f"cannot read the object template {path}: {told}; expected a complete PLY") from error
    return _checked(vertices, path)


def _checked(vertices: np.ndarray, path: Path) -> np.ndarray:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices) or not (np.abs(vertices) <= FARTHEST).all():
        raise DatasetError(f"the object template {path} has no finite vertices; export it again")
    return vertices

"""Whether a grid model's file describes one: checked before memory is asked for, and before a kernel reads anything.

The kernels check no bounds, so every index and size that comes from a file is checked here, once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import msgspec
import numpy as np

from chona_model.figure import pose_code_size
from chona_model.grid_model import GridModelShape
from chona_model.kernels.grid import FEATURES
from chona_model.plain_json import convert
from chona_model.tensor_reader import IdentityRows, TensorReader

FARTHEST = 1e4
"""Metres: no box reaches farther."""

MOST_CORNERS = 1 << 20
"""Of a grid along an axis: products of three fit 64 bits."""

Triple = tuple[float, float, float]
Size = tuple[int, int, int]


class _Box(msgspec.Struct):
    lower: Triple
    upper: Triple


class _Grid(msgspec.Struct):
    origin: Triple
    dims: Size


class _Tables(msgspec.Struct):
    dims: list[Size]
    lower: list[Triple]


class _Shape(msgspec.Struct):
    sizes: dict[str, Any]
    parts: list[_Box]
    grids: list[_Grid]
    tables: _Tables | None = None
    extent: Triple | None = None


def checked_sizes(shape: Mapping[str, Any], persons: int, objects: int) -> GridModelShape:
    """The sizes that a model file states, when everything beside them is sound.

    Args:
        shape: of the file's metadata; persons, objects: how many the file holds.

    Raises:
        ValueError: boxes, grids or tables are missing, empty, not finite or out of range.
    """
    known = convert(shape, _Shape)
    sizes = convert(known.sizes, GridModelShape)
    unknown = set(known.sizes) - {field.name for field in fields(GridModelShape)}
    if unknown:
        raise ValueError(f"the shape has an unknown field '{min(unknown)}': update the program")
    if len(known.parts) != persons + objects or len(known.grids) != persons:
        raise ValueError(
            f"there are {len(known.parts)} boxes and {len(known.grids)} skinning grids of {persons} persons and "
            f"{objects} objects"
        )
    for box in known.parts:
        if not _near(box.lower, box.upper) or any(a >= b for a, b in zip(box.lower, box.upper, strict=True)):
            raise ValueError(f"the box from {box.lower} to {box.upper} is none")
    for grid in known.grids:
        if not _near(grid.origin) or not _possible(grid.dims):
            raise ValueError(f"the skinning grid of {grid.dims} corners at {grid.origin} is none")
    if known.extent is not None and not (_near(known.extent) and min(known.extent) > 0.0):
        raise ValueError(f"the tables' extent is {known.extent} m")
    if known.tables is not None:
        tables = known.tables
        count = (persons > 0) + (objects > 0) if sizes.field.joint else persons + objects
        if len(tables.dims) != sizes.field.levels or len(tables.lower) != count:
            raise ValueError(f"there are {len(tables.dims)} levels and {len(tables.lower)} corners of the tables")
        if not _near(*tables.lower) or not all(map(_possible, tables.dims)):
            raise ValueError("the tables' levels or corners are out of range")
    return sizes


def check_tensors(
    sizes: GridModelShape, shape: Mapping[str, Any], tensors: TensorReader, bones: int, places: Mapping[str, int],
    rows: IdentityRows,
) -> None:  # fmt: skip
    """Whether the tensors of some identities have the shapes and types that the sizes give them.

    Args:
        sizes, shape: as ``checked_sizes`` has them.
        places: what the names of the chosen identities' tensors begin with, and their places among the file's parts.

    Raises:
        ValueError: one has not; the message names it.  SafetensorError: one is missing.
    """
    field, code = sizes.field, pose_code_size(bones, sizes.object_slots)
    for prefix, place in places.items():
        box = shape["parts"][place]
        cells = np.ceil(np.subtract(box["upper"], box["lower"]) / sizes.occupancy_cell)
        count = math.prod(max(int(along), 1) for along in cells)
        tensors.expect(f"{prefix}.table", (field.levels, 1 << field.rows, FEATURES))
        tensors.expect(f"{prefix}.density", (count,))
        tensors.expect(f"{prefix}.support", (count,), "BOOL")
        if place < rows.of_persons:
            nodes = tensors.shape(f"{prefix}.points")[0]
            tensors.expect(f"{prefix}.points", (nodes, 3), "F32")
            tensors.expect(f"{prefix}.skin.logits", (nodes, bones))
            tensors.expect(f"{prefix}.nodes", (math.prod(shape["grids"][place]["dims"]),), "I32")
            if sizes.offset_rank:
                tensors.expect(f"{prefix}.skin.offset_shapes", (nodes, sizes.offset_rank, 3))
                tensors.expect(f"{prefix}.skin.offset_mix.0.weight", (32, code))
    tensors.expect("field.pose_in.weight", (field.pose, code))
    tensors.expect("codes.persons", (max(rows.of_persons, 1), field.code))
    tensors.expect("codes.objects", (max(rows.of_objects, 1), field.code))


def check_nodes(name: str, nodes: np.ndarray, count: int) -> None:
    """``ValueError`` where a corner of the skinning grid of ``name`` has a node that is not among ``count``."""
    if not (nodes.min() >= 0 and nodes.max() < count):
        raise ValueError(f"corners of the skinning grid of '{name}' name nodes beyond its {count}")


def _near(*points: Triple) -> bool:
    return all(abs(value) <= FARTHEST for point in points for value in point)


def _possible(dims: Size) -> bool:
    return all(2 <= count <= MOST_CORNERS for count in dims)

"""Model files: safetensors with one JSON text of metadata (see docs/file-formats.md)."""

from __future__ import annotations

import hashlib
import json
import shutil
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from chona_model.formats.atomic import atomic_path
from chona_model.plain_json import JsonError, convert, parse, shortened
from chona_model.skeleton import Skeleton, SkeletonError

FORMAT = "chona-model"
VERSION = 1
TRADE = "chona.trade"
"""The metadata's entry for what ``chona trade`` measured; ``chona`` holds everything else."""

MAX_HEADER = 16_000_000
"""A safetensors header longer than this is damage or an attack, bytes; trained models have thousands."""

LARGEST = 1e4
"""Metres: joints, boxes and distances beyond are no person's and no object's."""

BLOCK = 1 << 22
"""Bytes copied or hashed at once."""


Triple = tuple[float, float, float]


class _Entry(msgspec.Struct):
    """Of a tensor, in a safetensors header."""

    dtype: str
    shape: list[int]
    data_offsets: tuple[int, int]


class _Skeleton(msgspec.Struct):
    names: list[str]
    parents: list[int]


class _Person(msgspec.Struct):
    rest_joints: list[Triple]


class _Object(msgspec.Struct):
    lower: Triple
    upper: Triple


class _Content(msgspec.Struct):
    """The metadata's entry ``chona``; what is behind ``shape`` is the actor's own to check."""

    method: str
    field: str
    skeleton: _Skeleton
    persons: dict[str, _Person]
    objects: dict[str, _Object]
    object_distance: float
    settings: dict[str, Any]
    training: dict[str, Any]
    shape: dict[str, Any]


class _Measured(msgspec.Struct):
    """What commands use of one preset's figures."""

    seconds: float
    fixed_seconds: float
    seconds_per_ray: float
    psnr: float | None = None
    ssim: float | None = None


class _Reference(msgspec.Struct):
    person: str | None
    objects: list[str]
    world_from_bone: list[list[list[float]]] | None
    world_from_object: list[list[list[float]]]
    intrinsics: tuple[Triple, Triple, Triple]
    world_from_camera: list[list[float]]
    width: int
    height: int
    kind: str


class _Trade(msgspec.Struct):
    presets: dict[str, _Measured]
    size: tuple[int, int]
    views: int
    reference: _Reference


class ModelFileError(ValueError):
    """A model file that cannot be used: the message says what was found, what was expected and what to do."""


@dataclass(frozen=True)
class ModelHeader:
    """What a model file says of itself.

    Attributes:
        path, size_bytes: the file; version: of the format.
        method: ``chona``, ``no-cil``, …; field: ``grid`` or ``exact``.
        skeleton: body bones.
        persons: by name {"rest_joints": [[x, y, z], …]}; objects: by name {"lower": [..], "upper": [..]}.
        object_distance: metres.
        settings, training, shape: JSON objects.
        trade: what ``chona trade`` measured of the model, as ``trade.summary`` has it; None where it was not measured.
    """

    path: Path
    size_bytes: int
    version: int
    method: str
    field: str
    skeleton: Skeleton
    persons: dict[str, Any]
    objects: dict[str, Any]
    object_distance: float
    settings: dict[str, Any]
    training: dict[str, Any]
    shape: dict[str, Any]
    trade: dict[str, Any] | None = None

    def rest_joints(self, person: str) -> np.ndarray:
        """[B, 3] canonical joints of a person, metres."""
        return np.array(self.persons[person]["rest_joints"], dtype=np.float64)


def read_metadata(path: Path) -> dict[str, str]:
    """The ``__metadata__`` of a safetensors file, without reading any tensor.

    Raises:
        ModelFileError: missing, no safetensors file, or cut off.
    """
    return _read_json(path)[0].get("__metadata__", {})


def _read_json(path: Path) -> tuple[dict[str, Any], int]:
    """The JSON of a safetensors file, and the byte at which its tensors begin; raises as ``read_metadata``."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(8)
            length = struct.unpack("<Q", start)[0] if len(start) == 8 else 0
            if not 2 <= length <= min(MAX_HEADER, size - 8):
                raise ModelFileError(
                    f"{path} is no safetensors file or was cut off ({size} bytes); expected a model.safetensors that "
                    "'chona train' wrote: copy it again or train anew"
                )
            header = parse(file.read(length))
            entries = _entries(header)
    except FileNotFoundError as error:
        raise ModelFileError(
            f"there is no model file {path}; expected a model.safetensors: train one with 'chona train'"
        ) from error
    except (OSError, JsonError) as error:
        raise ModelFileError(
            f"cannot read {path}: {error}; expected a model.safetensors that 'chona train' wrote"
        ) from error
    end = max((entry.data_offsets[1] for entry in entries), default=0)
    if size < 8 + length + end:
        raise ModelFileError(f"{path} is cut off: {size} bytes of {8 + length + end}; copy it again")
    return header, 8 + length


def _entries(header: Any) -> list[_Entry]:
    """The tensors that a safetensors header describes; ``JsonError`` where it is none."""
    convert(header, dict[str, dict[str, Any]])
    convert(header.get("__metadata__", {}), dict[str, str])
    return [convert(entry, _Entry) for name, entry in header.items() if name != "__metadata__"]


def read_header(path: Path) -> ModelHeader:
    """Reads and checks a model file's metadata.

    Raises:
        ModelFileError: not a model file, of another version, or incomplete.
    """
    metadata = read_metadata(path)
    try:
        content = parse(metadata.get("chona", "{}"))
        trade = parse(metadata.get(TRADE, "null"))
        convert(content, dict[str, Any])
        convert({} if trade is None else trade, dict[str, Any])
        if content.get("format") != FORMAT:
            raise ModelFileError(
                f"{path} is a safetensors file but no CHONA model: its format is "
                f"'{shortened(content.get('format'))}', expected '{FORMAT}'; give a file that 'chona train' wrote"
            )
        if content.get("version") != VERSION:
            raise ModelFileError(
                f"{path} has model version {shortened(content.get('version'))}, this program reads version {VERSION}; "
                "update the program, or train the model again with it"
            )
        known = convert(content, _Content)
        skeleton = Skeleton(tuple(known.skeleton.names), tuple(known.skeleton.parents))
        _check_identities(known)
        return ModelHeader(
            path, path.stat().st_size, VERSION, known.method, known.field, skeleton, content["persons"],
            content["objects"], known.object_distance, known.settings, known.training, known.shape, trade,
        )  # fmt: skip
    except (JsonError, SkeletonError) as error:
        raise ModelFileError(f"the metadata of {path} is incomplete or damaged ({error}); copy it again") from error


def _check_identities(content: _Content) -> None:
    """``JsonError`` where joints or boxes are none, by the name of whose they are."""
    bones = len(content.skeleton.names)
    for name, person in content.persons.items():
        if len(person.rest_joints) != bones or not _near(*person.rest_joints):
            raise JsonError(
                f"the rest joints of '{name}' are not {bones} points within {LARGEST:g} m, one of every bone"
            )
    for name, thing in content.objects.items():
        if not _near(thing.lower, thing.upper) or any(a >= b for a, b in zip(thing.lower, thing.upper, strict=True)):
            raise JsonError(f"the box of '{name}' from {thing.lower} to {thing.upper} is none")
    if not 0.0 <= content.object_distance <= LARGEST:
        raise JsonError(f"the object distance is {content.object_distance} m, expected 0 to {LARGEST:g}")


def _near(*points: Triple) -> bool:
    return all(abs(value) <= LARGEST for point in points for value in point)


def check_trade(path: Path, trade: Mapping[str, Any]) -> None:
    """``ModelFileError`` where what was measured of a model cannot be used; the model itself can."""
    try:
        convert(trade, _Trade)
    except JsonError as error:
        raise ModelFileError(
            f"what was measured of {path} is damaged ({error}); measure it again with 'chona trade'"
        ) from error


def file_hash(path: Path) -> str:
    """SHA-256 of what pictures depend on, hexadecimal: the header without what ``chona trade`` put there, and the data.

    Raises:
        ModelFileError: see ``read_metadata``.
    """
    header, data = _read_json(path)
    metadata = header.get("__metadata__", {})
    header["__metadata__"] = {name: text for name, text in metadata.items() if name != TRADE}
    with path.open("rb") as file:
        file.seek(data)
        digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()


def write_trade(path: Path, trade: Mapping[str, Any]) -> None:
    """Puts what was measured of a model into its file, whole or not at all; tensors are copied as they are.

    Raises:
        ModelFileError: see ``read_metadata``.  OSError: the file or its folder cannot be written to.
    """
    header, data = _read_json(path)
    header["__metadata__"] = header.get("__metadata__", {}) | {TRADE: json.dumps(trade)}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # tensors begin at multiples of eight bytes
    with path.open("rb") as file, atomic_path(path) as temporary, temporary.open("wb") as new:
        file.seek(data)
        new.write(struct.pack("<Q", len(text)) + text)
        shutil.copyfileobj(file, new, BLOCK)

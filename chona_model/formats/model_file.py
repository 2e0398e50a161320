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

import numpy as np

from chona_model.formats.atomic import atomic_path
from chona_model.skeleton import Skeleton, SkeletonError

FORMAT = "chona-model"
VERSION = 1
TRADE = "chona.trade"
"""The metadata's entry for what ``chona trade`` measured; ``chona`` holds everything else."""

MAX_HEADER = 100_000_000
"""A safetensors header longer than this is damage or an attack, bytes."""

BLOCK = 1 << 22
"""Bytes copied or hashed at once."""


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
            header = json.loads(file.read(length))
    except FileNotFoundError as error:
        raise ModelFileError(
            f"there is no model file {path}; expected a model.safetensors: train one with 'chona train'"
        ) from error
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ModelFileError(
            f"cannot read {path}: {error}; expected a model.safetensors that 'chona train' wrote"
        ) from error
    if not isinstance(header, dict):
        return {}, 8 + length
    end = max((entry["data_offsets"][1] for name, entry in header.items() if name != "__metadata__"), default=0)
    if size < 8 + length + end:
        raise ModelFileError(f"{path} is cut off: {size} bytes of {8 + length + end}; copy it again")
    return header, 8 + length


def read_header(path: Path) -> ModelHeader:
    """Reads and checks a model file's metadata.

    Raises:
        ModelFileError: not a model file, of another version, or incomplete.
    """
    metadata = read_metadata(path)
    text = metadata.get("chona")
    try:
        content = json.loads(text) if text is not None else {}
        if content.get("format") != FORMAT:
            raise ModelFileError(
                f"{path} is a safetensors file but no CHONA model: its format is '{content.get('format')}', expected "
                f"'{FORMAT}'; give a file that 'chona train' wrote"
            )
        if content.get("version") != VERSION:
            raise ModelFileError(
                f"{path} has model version {content.get('version')}, this program reads version {VERSION}; update the "
                "program, or train the model again with it"
            )
        return ModelHeader(
            path, path.stat().st_size, content["version"], content["method"], content["field"],
            Skeleton(tuple(content["skeleton"]["names"]), tuple(content["skeleton"]["parents"])),
            content["persons"], content["objects"], float(content["object_distance"]), content["settings"],
            content["training"], content["shape"], json.loads(metadata.get(TRADE, "null")),
        )  # fmt: skip
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError, SkeletonError) as error:
        raise ModelFileError(f"the metadata of {path} is incomplete or damaged ({error!r}); copy it again") from error


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

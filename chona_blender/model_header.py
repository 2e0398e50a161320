"""What the add-on has to know of a model file: its safetensors header, read with the standard library alone."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .errors import ChonaError

MODEL_VERSION = 1
"""Version of the model format that this add-on reads."""

LARGEST_HEADER = 16_000_000
"""Bytes; a longer header is taken for a file of another kind."""

MOST_BONES = 2048
LONGEST = 200
"""Characters of an error's words: some repeat the file."""

FARTHEST = 1e4
"""Metres: no joint and no corner of a box lies farther."""


@dataclass(frozen=True)
class ModelHeader:
    """Skeleton and identities of a model file.

    Attributes:
        path: the file.
        names: B bone names, parents before children.
        parents: B indices of parents, -1 for the root.
        persons: rest joints [B, 3] of every person, canonical space (T-pose, y up, facing +z), metres.
        objects: corners (lower [3], upper [3]) of every object in its own frame, metres.
        object_distance: how far in front of the root joint (+z) objects lie in canonical space, metres.
        method: name of the trained method.
        version: format version of the file.
        raw: the whole JSON description.
        trade: what `chona trade` measured of the model, {"presets": {name: {"seconds", "psnr", …}}, …}; None where it
            was not measured, or where that is damaged.
        trade_problem: what is wrong with a damaged one; the model can be used all the same.
    """

    path: Path
    names: tuple[str, ...]
    parents: tuple[int, ...]
    persons: dict[str, np.ndarray]
    objects: dict[str, tuple[np.ndarray, np.ndarray]]
    object_distance: float
    method: str
    version: int
    raw: dict[str, Any] = field(repr=False, compare=False)
    trade: dict[str, Any] | None = field(default=None, repr=False, compare=False)
    trade_problem: str = ""

    def rest_joints(self, person: str) -> np.ndarray:
        """Canonical rest joints [B, 3] of a person, metres.

        Raises:
            ChonaError: the model has no such person.
        """
        self._check("person", person, self.persons)
        return self.persons[person]

    def extents(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Corners (lower [3], upper [3]) of an object in its own frame, metres.

        Raises:
            ChonaError: the model has no such object.
        """
        self._check("object", name, self.objects)
        return self.objects[name]

    def _check(self, kind: str, name: str, known: Collection[str]) -> None:
        if name not in known:
            raise ChonaError(f"Model '{self.path.name}' has no {kind} '{name}'. It has: {_listed(known)}. Choose one")

    def canonical_object(self, person: str | None) -> np.ndarray:
        """Canonical position [3] of every object's frame, metres; without a person that of the first person."""
        joints = self.rest_joints(person) if person else next(iter(self.persons.values()), np.zeros((1, 3)))
        return joints[0] + np.array([0.0, 0.0, self.object_distance])


def _listed(names: Any) -> str:
    return ", ".join(f"'{name}'" for name in names) or "none"


def _read_metadata(path: Path) -> tuple[dict[str, Any], object]:
    """The description in a safetensors file's header, and what stands there as its trade, unchecked."""
    other = f"'{path}' is not a CHONA model file (a .safetensors file that 'chona train' writes)"
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(8)
            if len(start) < 8:
                raise ChonaError(f"{other}: it has only {size} bytes. Choose another file")
            length = struct.unpack("<Q", start)[0]
            if length >= LARGEST_HEADER or length + 8 > size:
                raise ChonaError(
                    f"{other}: its header claims {length} bytes and the file has {size}. It may be cut short: copy it "
                    "again, or choose another file"
                )
            text = file.read(length)
    except FileNotFoundError:
        raise ChonaError(f"There is no model file '{path}'. Choose a .safetensors file from 'chona train'") from None
    except OSError as error:
        raise ChonaError(f"Model file '{path}' cannot be read ({error.strerror}). Choose another file") from error
    try:
        header = json.loads(text)
    except (ValueError, RecursionError):
        raise ChonaError(f"{other}: its header is not JSON. Choose another file") from None
    metadata = header.get("__metadata__") if isinstance(header, dict) else None
    if not isinstance(metadata, dict) or not isinstance(metadata.get("chona"), str):
        raise ChonaError(f"{other}: its header has no entry 'chona'. Choose another file")
    try:
        raw = json.loads(metadata["chona"])
        json.dumps(raw, ensure_ascii=False).encode()  # half a surrogate pair passes the parser, and nothing shows it
    except (ValueError, RecursionError):
        raise ChonaError(f"{other}: its entry 'chona' is not JSON. Choose another file") from None
    if not isinstance(raw, dict) or raw.get("format") != "chona-model":
        raise ChonaError(f"{other}: its format is not 'chona-model'. Choose another file")
    return raw, metadata.get("chona.trade")


def read_trade(text: object) -> tuple[dict[str, Any] | None, str]:
    """What was measured of a model, and what is wrong with it: a model that nobody measured has neither."""
    if text is None:
        return None, ""
    try:
        trade = json.loads(text)  # type: ignore[arg-type]
        json.dumps(trade, ensure_ascii=False).encode()
        for figures in trade["presets"].values():
            known = (figures["seconds"], *(figures[name] for name in ("psnr", "ssim") if figures[name] is not None))
            if not all(isinstance(value, float | int) and math.isfinite(value) for value in known):
                raise ValueError("a figure that is no number")
        if not all(isinstance(length, int) for length in trade["size"]) or len(trade["size"]) != 2:
            raise ValueError("no size")
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        words = f"{type(error).__name__}: {str(error)[:LONGEST]}"
        return None, f"What was measured of this model is damaged ({words}). Measure it again"
    return trade, ""


def _joints(value: Any, bones: int, person: str, path: Path) -> np.ndarray:
    joints = np.array(value, dtype=np.float64)
    if joints.shape != (bones, 3) or not (np.abs(joints) <= FARTHEST).all():
        raise ChonaError(
            f"Model '{path.name}': person '{person}' has rest joints of shape {list(joints.shape)}, expected "
            f"[{bones}, 3] finite numbers. Train the model again"
        )
    return joints


def _corners(value: Any, name: str, path: Path) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = (np.array(value[corner], dtype=np.float64) for corner in ("lower", "upper"))
    if not lower.shape == upper.shape == (3,) or not (np.abs([lower, upper]) <= FARTHEST).all():
        raise ChonaError(
            f"Model '{path.name}': the box of object '{name}' is no two corners of three finite numbers. Train the "
            "model again"
        )
    return lower, upper


def read_model_header(path: str | Path) -> ModelHeader:
    """Reads a model file's description; no tensor is touched.

    Raises:
        ChonaError: no such file, not a model file, another version, or a description that contradicts itself.
    """
    path = Path(path)
    raw, measured = _read_metadata(path)
    version = raw.get("version")
    if version != MODEL_VERSION:
        newer = isinstance(version, int) and version > MODEL_VERSION
        remedy = "update the add-on" if newer else "train the model again with this version's 'chona train'"
        given = str(version)[:LONGEST]
        raise ChonaError(f"'{path.name}' is model version {given}, this add-on reads version {MODEL_VERSION}: {remedy}")
    try:
        names = tuple(str(name) for name in raw["skeleton"]["names"])
        parents = tuple(int(parent) for parent in raw["skeleton"]["parents"])
        if not 0 < len(names) <= MOST_BONES or len(set(names)) != len(names):
            raise ValueError(f"{len(names)} bones, expected 1 to {MOST_BONES}, each with a name of its own")
        if len(names) != len(parents) or any(not -1 <= parent < index for index, parent in enumerate(parents)):
            raise ValueError("parents must come before their children")
        persons = {name: _joints(each["rest_joints"], len(names), name, path) for name, each in raw["persons"].items()}
        objects = {name: _corners(each, name, path) for name, each in raw["objects"].items()}
        distance = float(raw.get("object_distance", 0.0))
        if not 0.0 <= distance <= FARTHEST:
            raise ValueError(f"an object distance of {distance} m")
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        words = f"{type(error).__name__}: {str(error)[:LONGEST]}"
        raise ChonaError(f"Model '{path.name}' has a damaged description ({words}). Train or copy it again") from error
    method, trade = str(raw.get("method", "")), read_trade(measured)
    return ModelHeader(path, names, parents, persons, objects, distance, method, version, raw, *trade)

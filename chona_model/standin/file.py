"""Stand-ins as files (docs/file-formats.md): arrays without pickle and a header in JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chona_model.formats.atomic import atomic_path
from chona_model.skeleton import Skeleton

FORMAT = "chona-stand-in"
VERSION = 1


@dataclass(frozen=True)
class PartMesh:
    """The mesh of one person (canonical space) or object (its own frame), metres.

    Attributes:
        kind: ``person`` or ``object``; name: of the identity.
        vertices: [V, 3] float32; faces: [F, 3] int32, counter-clockwise from outside; normals: [V, 3] float32.
        colours: [V, 3] uint8 sRGB.
        bones: [V, 4] int16 indices in the skeleton, −1 for none; weights: [V, 4] float32, rows sum to one; both None
            for an object.
    """

    kind: str
    name: str
    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    colours: np.ndarray
    bones: np.ndarray | None
    weights: np.ndarray | None


@dataclass(frozen=True)
class StandIn:
    """Meshes of a model's parts.

    Attributes:
        skeleton: of the model; rest_joints: [B, 3] of the person, None without one.
        model_hash: of the model file; voxel: metres; opacity: of a voxel's length on the surface.
        parts: at most one person, then objects.
    """

    skeleton: Skeleton
    rest_joints: np.ndarray | None
    model_hash: str
    voxel: float
    opacity: float
    parts: tuple[PartMesh, ...]


def write_stand_in(path: Path, stand_in: StandIn) -> None:
    """Writes a stand-in whole or not at all.

    Raises:
        OSError: the disk is full or the folder cannot be written to.
    """
    joints = stand_in.rest_joints
    header = {
        "format": FORMAT, "version": VERSION, "model": stand_in.model_hash, "voxel": stand_in.voxel,
        "opacity": stand_in.opacity,
        "skeleton": {"names": list(stand_in.skeleton.names), "parents": list(stand_in.skeleton.parents)},
        "rest_joints": None if joints is None else joints.tolist(),
        "parts": [
            {"kind": part.kind, "name": part.name, "vertices": len(part.vertices), "faces": len(part.faces)}
            for part in stand_in.parts
        ],
    }  # fmt: skip
    arrays = {"header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)}
    for index, part in enumerate(stand_in.parts):
        for name in ("vertices", "faces", "normals", "colours", "bones", "weights"):
            values = getattr(part, name)
            if values is not None:
                arrays[f"part.{index}.{name}"] = values
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]

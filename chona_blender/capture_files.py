"""The files of a capture: descriptions, poses, what is finished, and ``capture.json`` (docs/file-formats.md)."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from .errors import ChonaError
from .shot_file import write_npz

POSE_TOLERANCE = 1e-5
"""Frames whose pose or cameras moved more than this since they were rendered are rendered again."""


def frame_folder(frame: int) -> str:
    """Name of a frame's folder."""
    return f"{frame:04d}"


_FRAME_AXIS = {"frames": 0, "world_from_bone": 0, "world_from_object": 0, "intrinsics": 1, "world_from_camera": 1}


def resume(folder: Path, description: dict[str, Any], arrays: dict[str, np.ndarray]) -> set[int]:
    """Finished frames that still hold; writes description and poses, keeping finished frames of earlier calls.

    Raises:
        ChonaError: the folder holds a sequence with other cameras, sizes or identities.
    """
    before = _earlier(folder, description)
    finished: set[int] = set()
    if before is not None:
        finished = _holding(folder, before, arrays)
        arrays = _merge(folder, before, arrays, finished)
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob(".*.partial"):
        shutil.rmtree(stale)
    write_npz(folder / "poses.npz", arrays)
    _write_json(folder / "sequence.json", description)
    return finished


def finished_frames(folder: Path, description: dict[str, Any], arrays: dict[str, np.ndarray]) -> set[int]:
    """As ``resume``, and nothing is written."""
    before = _earlier(folder, description)
    return set() if before is None else _holding(folder, before, arrays)


def _earlier(folder: Path, description: dict[str, Any]) -> dict[str, np.ndarray] | None:
    """The poses of what the folder holds already, which must be the same sequence; None where there is nothing."""
    about, poses = folder / "sequence.json", folder / "poses.npz"
    if not (about.exists() and poses.exists()):
        return None
    old = json.loads(about.read_text(encoding="utf-8"))
    for key in ("person", "objects", "cameras", "width", "height", "skeleton"):
        if old[key] != description[key]:
            raise ChonaError(
                f"'{folder}' already holds a sequence with other {key}. Choose another name for this sequence, or "
                "delete that folder"
            )
    with np.load(poses, allow_pickle=False) as file:
        return {name: file[name] for name in _FRAME_AXIS}


def _holding(folder: Path, before: dict[str, np.ndarray], arrays: dict[str, np.ndarray]) -> set[int]:
    """Finished frames whose poses and cameras are as they were."""
    new, limit = arrays["frames"].tolist(), POSE_TOLERANCE * max(1.0, np.abs(arrays["intrinsics"]).max() / 1000.0)
    holding = set()
    for index, frame in enumerate(before["frames"].tolist()):
        if frame not in new or not (folder / frame_folder(frame)).is_dir():
            continue
        here = new.index(frame)
        change = max(
            np.abs(np.take(before[name], index, axis) - np.take(arrays[name], here, axis)).max(initial=0.0)
            for name, axis in _FRAME_AXIS.items()
        )
        if change <= limit:
            holding.add(frame)
    return holding


def _merge(
    folder: Path, before: dict[str, np.ndarray], arrays: dict[str, np.ndarray], finished: set[int]
) -> dict[str, np.ndarray]:
    """New arrays with the frames of ``before`` that they lack; removes frames that do not hold any more."""
    new = arrays["frames"].tolist()
    kept = []
    for index, frame in enumerate(before["frames"].tolist()):
        path = folder / frame_folder(frame)
        if path.is_dir() and frame not in new:
            kept.append(index)
        elif path.is_dir() and frame not in finished:
            shutil.rmtree(path)
    joined = {
        name: np.concatenate([np.take(before[name], kept, axis), arrays[name]], axis)
        for name, axis in _FRAME_AXIS.items()
    }
    order = joined["frames"].argsort()
    return {name: np.take(joined[name], order, axis) for name, axis in _FRAME_AXIS.items()}


def _write_json(path: Path, value: Any) -> None:
    temporary = path.with_name(f".{path.name}.partial")
    temporary.write_text(json.dumps(value), encoding="utf-8")
    temporary.replace(path)


def finish_capture(folder: str | Path, sequences: Iterable[str] | None = None) -> Path:
    """Writes ``capture.json`` from the sequences in the folder; the capture is readable from then on.

    Args:
        sequences: names in the order they are listed; None takes all, sorted.

    Returns:
        the file.

    Raises:
        ChonaError: no sequence, one with missing frames, or sequences that contradict each other.
    """
    folder = Path(folder)
    names = list(sequences) if sequences is not None else sorted(p.parent.name for p in _descriptions(folder))
    if not names:
        raise ChonaError(f"'{folder}' holds no captured sequence. Capture one first")
    capture: dict[str, Any] = {
        "format": "chona-capture", "version": 1, "skeleton": None, "persons": {}, "objects": {}, "sequences": [],
    }  # fmt: skip
    for name in names:
        about = folder / "sequences" / name / "sequence.json"
        if not about.exists():
            raise ChonaError(f"'{folder}' holds no sequence '{name}'. Capture it first")
        each = json.loads(about.read_text(encoding="utf-8"))
        with np.load(about.with_name("poses.npz"), allow_pickle=False) as file:
            lacking = [n for n in file["frames"].tolist() if not about.with_name(frame_folder(n)).is_dir()]
        if lacking:
            raise ChonaError(
                f"Sequence '{name}' lacks {len(lacking)} frames, the first is {lacking[0]}. Run its capture again: "
                "finished frames are kept"
            )
        _add_sequence(capture, each)
    path = folder / "capture.json"
    _write_json(path, capture)
    return path


def _descriptions(folder: Path) -> Iterable[Path]:
    return (folder / "sequences").glob("*/sequence.json")


def _add_sequence(capture: dict[str, Any], each: dict[str, Any]) -> None:
    if capture["skeleton"] is None:
        capture["skeleton"] = each["skeleton"]
    elif capture["skeleton"] != each["skeleton"]:
        raise ChonaError(f"Sequence '{each['name']}' has another skeleton than the first. Capture it in its own folder")
    person = capture["persons"].setdefault(each["person"], {"rest_joints": each["rest_joints"]})
    if np.abs(np.array(person["rest_joints"]) - np.array(each["rest_joints"])).max() > 1e-3:
        raise ChonaError(
            f"Person '{each['person']}' has another rest pose or size in sequence '{each['name']}'. Give it another "
            "name there"
        )
    for name, extent in each["extents"].items():
        known = capture["objects"].setdefault(name, extent)
        capture["objects"][name] = {
            "lower": np.minimum(known["lower"], extent["lower"]).tolist(),
            "upper": np.maximum(known["upper"], extent["upper"]).tolist(),
        }
    capture["sequences"].append({key: each[key] for key in ("name", "person", "objects", "cameras", "width", "height")})

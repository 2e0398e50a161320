"""Runs scripts in the Pythons with bpy that $CHONA_BPY names, for the tests of the add-on's operation side."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = Path(__file__).parent / "scripts"


FIGURE = (
    ("pelvis", -1, (0.0, 0.95, 0.0)),
    ("spine", 0, (0.0, 1.12, 0.0)),
    ("neck", 1, (0.0, 1.45, 0.0)),
    ("head", 2, (0.0, 1.55, 0.02)),
    ("left_hip", 0, (0.09, 0.9, 0.0)),
    ("left_knee", 4, (0.1, 0.5, 0.0)),
    ("left_ankle", 5, (0.1, 0.09, -0.02)),
    ("left_shoulder", 1, (0.17, 1.4, 0.0)),
    ("left_elbow", 7, (0.44, 1.4, 0.0)),
    ("left_wrist", 8, (0.69, 1.4, 0.0)),
    ("right_hip", 0, (-0.09, 0.9, 0.0)),
    ("right_knee", 10, (-0.1, 0.5, 0.0)),
    ("right_ankle", 11, (-0.1, 0.09, -0.02)),
    ("right_shoulder", 1, (-0.17, 1.4, 0.0)),
    ("right_elbow", 13, (-0.44, 1.4, 0.0)),
    ("right_wrist", 14, (-0.69, 1.4, 0.0)),
)
"""A small figure: bone, parent, canonical rest joint."""


def bpy_pythons() -> list[str]:
    """The Pythons with bpy, or one entry that makes tests skip."""
    found = [part for part in os.environ.get("CHONA_BPY", "").split(os.pathsep) if part]
    return found or [""]


def run_bpy(
    python: str, script: str, *arguments: object, environment: dict[str, str] | None = None, seconds: float = 300.0,
    steady: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Run one of our scripts in a Python with bpy; what it writes as its last line of stdout, in JSON, comes back.

    Args:
        steady: no exception may be printed, also none that Blender prints of a handler and goes on.
    """
    if not python:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    full = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "CHONA_WORKER"))}
    full |= {"PYTHONPATH": os.pathsep.join([str(ROOT), str(SCRIPTS)])} | (environment or {})
    done = subprocess.run(
        [python, str(SCRIPTS / script), *map(str, arguments)],
        env=full, capture_output=True, text=True, timeout=seconds, check=False,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode != 0 or not lines:
        raise AssertionError(f"{script} ended with {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-6000:]}")
    if steady and "Traceback" in done.stdout + done.stderr:
        raise AssertionError(f"{script} printed an exception\n{done.stdout[-4000:]}\n{done.stderr[-6000:]}")
    return json.loads(lines[-1])


def needs_worker(python: str) -> None:
    """Skips where there is no bpy, or no torch for a worker; then the helpers of ``tests/model`` can be imported."""
    if not python:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    pytest.importorskip("torch")
    sys.path.insert(0, str(ROOT / "tests" / "model"))


def write_two_models(folder: Path) -> tuple[Path, Path]:
    """Small models of the same person and object that look different; for tests that ``needs_worker``."""
    sys.path.insert(0, str(ROOT / "tests" / "faults"))
    import torch
    from untrained_models import write_grid_model

    from chona_model.grid_actor import GridActor
    from chona_model.model_store import load_actor, save_actor

    one, other = write_grid_model(folder / "one.safetensors"), folder / "other.safetensors"
    actor = load_actor(one)
    assert isinstance(actor, GridActor)
    with torch.no_grad():
        actor.model.field.density_out.bias.fill_(4.0)
    save_actor(other, actor, "chona", {"preset": "fast"}, {"steps": 2})
    return one, other


def write_header_only_model(path: Path, version: int = 1) -> Path:
    """A model file whose header is right and whose tensors are not there: all that the add-on reads."""
    description = {
        "format": "chona-model",
        "version": version,
        "method": "chona",
        "field": "grid",
        "skeleton": {"names": [name for name, _, _ in FIGURE], "parents": [parent for _, parent, _ in FIGURE]},
        "persons": {"Robin": {"rest_joints": [joint for _, _, joint in FIGURE]}},
        "objects": {"crate": {"lower": [-0.2, -0.2, -0.2], "upper": [0.2, 0.2, 0.2]}},
        "object_distance": 1.5,
        "settings": {},
        "training": {},
    }
    header = json.dumps({"__metadata__": {"chona": json.dumps(description)}}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header)
    return path

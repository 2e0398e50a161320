"""Runs scripts in the Pythons with bpy that $CHONA_BPY names, for the tests of the add-on's operation side."""

from __future__ import annotations

import json
import os
import struct
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = Path(__file__).parent / "scripts"


def bpy_pythons() -> list[str]:
    """The Pythons with bpy, or one entry that makes tests skip."""
    found = [part for part in os.environ.get("CHONA_BPY", "").split(os.pathsep) if part]
    return found or [""]


def run_bpy(python: str, script: str, *arguments: object, environment: dict[str, str] | None = None) -> dict[str, Any]:
    """Run one of our scripts in a Python with bpy; what it writes as its last line of stdout, in JSON, comes back."""
    if not python:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    full = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "CHONA_WORKER"))}
    full |= {"PYTHONPATH": os.pathsep.join([str(ROOT), str(SCRIPTS)])} | (environment or {})
    done = subprocess.run(
        [python, str(SCRIPTS / script), *map(str, arguments)],
        env=full, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode != 0 or not lines:
        raise AssertionError(f"{script} ended with {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-6000:]}")
    return json.loads(lines[-1])


def write_header_only_model(path: Path, version: int = 1) -> Path:
    """A model file whose header is right and whose tensors are not there: all that the add-on reads."""
    description = {
        "format": "chona-model",
        "version": version,
        "method": "chona",
        "field": "grid",
        "skeleton": {"names": ["pelvis", "left_hip", "right_hip", "spine"], "parents": [-1, 0, 0, 0]},
        "persons": {"Robin": {"rest_joints": [[0, 0.9, 0], [0.1, 0.8, 0], [-0.1, 0.8, 0], [0, 1.1, 0]]}},
        "objects": {"crate": {"lower": [-0.2, -0.2, -0.2], "upper": [0.2, 0.2, 0.2]}},
        "object_distance": 1.5,
        "settings": {},
        "training": {},
    }
    header = json.dumps({"__metadata__": {"chona": json.dumps(description)}}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header)
    return path

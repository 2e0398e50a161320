"""A tiny capture in BEHAVE's layout, with a body model of 24 tetrahedra."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tiny_behave import write_body_model

SEQUENCE = "Date01_Sub01_crate_lift"
CENTRE = np.array([0.3, -0.2, 0.1])
FX, CX, CY = 40.0, 15.5, 11.5


def _write_fit(frame: Path, pose: np.ndarray | None = None) -> None:
    """Fits of one frame: the person two metres away, the object turned by a right angle about y."""
    for name, content in (
        ("person", {"pose": np.zeros(156) if pose is None else pose, "betas": np.zeros(2), "trans": [0.0, 0.0, 2.0]}),
        ("crate", {"angle": np.array([0.0, np.pi / 2, 0.0]), "trans": np.array([0.1, 0.2, 2.5])}),
    ):
        folder = frame / name / ("fit02" if name == "person" else "fit01")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}_fit.pkl").write_bytes(pickle.dumps(content, protocol=2))


@pytest.fixture
def write_fit() -> Callable[..., None]:
    """Writes the fits of a frame folder, with another body pose if given."""
    return _write_fit


@pytest.fixture
def tiny_behave(tmp_path: Path) -> Path:
    """Root of a capture with one sequence, two frames and two Kinects."""
    root = tmp_path / "capture"
    write_body_model(root / "smplh")
    for kinect in (0, 1):
        for folder, name, content in (
            (f"calibs/intrinsics/{kinect}", "calibration.json",
             {"color": {"fx": FX, "fy": FX, "cx": CX, "cy": CY, "width": 32, "height": 24,
                        "opencv": [FX, FX, CX, CY, *[0.0] * 8]}}),
            (f"calibs/Date01/config/{kinect}", "config.json",
             {"rotation": np.eye(3).reshape(-1).tolist(), "translation": [0.1 * (1 - kinect), 0.0, 0.0]}),
        ):  # fmt: skip
            (root / folder).mkdir(parents=True)
            (root / folder / name).write_text(json.dumps(content))
    template = root / "objects" / "crate"
    template.mkdir(parents=True)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)]) * 0.1 + CENTRE
    rows = "\n".join(" ".join(map(str, corner)) for corner in corners)
    properties = "\n".join(f"property float {axis}" for axis in "xyz")
    (template / "crate_f1000.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 8\n{properties}\nend_header\n{rows}\n"
    )
    sequence = root / "sequences" / SEQUENCE
    sequence.mkdir(parents=True)
    (sequence / "info.json").write_text(
        json.dumps({"config": "../../calibs/Date01/config", "intrinsic": "../../calibs/intrinsics", "cat": "crate",
                    "gender": "male", "kinects": [0, 1]})
    )  # fmt: skip
    for name in ("t0003.000", "t0004.000"):
        frame = sequence / name
        _write_fit(frame)
        for kinect in (0, 1):
            Image.new("RGB", (32, 24), (200, 100, 50)).save(frame / f"k{kinect}.color.jpg")
            for mask in ("person_mask", "obj_rend_mask"):
                Image.new("L", (32, 24), 255 if mask == "person_mask" else 0).save(frame / f"k{kinect}.{mask}.jpg")
    return root

"""Captures in BEHAVE's layout with any sequences: a body of 24 tetrahedra and a box, drawn as discs and a polygon."""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import ConvexHull

from chona_model.skeleton import SMPL, SMPL_PARENTS

WIDTH, HEIGHT, FOCAL = 64, 48, 50.0
HALF = np.array([0.25, 0.2, 0.15])
DISC = 0.12
"""Radius of what is drawn around a joint, metres."""
KINECTS = (0, 1)


def body_joints() -> np.ndarray:
    """[24, 3] canonical joints of ``write_body_model``'s body, metres."""
    return np.random.default_rng(3).normal(size=(24, 3)) * 0.3


def write_body_model(folder: Path, name: str = "SMPL_male.npz") -> None:
    """SMPL's joints in a row of small tetrahedra, one a bone."""
    folder.mkdir(parents=True, exist_ok=True)
    corner = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.02
    vertices = (body_joints()[:, None] + corner).reshape(-1, 3)
    weights = np.repeat(np.eye(24), 4, axis=0)
    faces = np.concatenate([np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]) + 4 * bone for bone in range(24)])
    parents = np.array(SMPL_PARENTS, dtype=np.int64)
    np.savez(
        folder / name,
        v_template=vertices, f=faces, J_regressor=weights.T / 4, weights=weights, shapedirs=np.zeros((96, 3, 2)),
        kintree_table=np.stack([parents, np.arange(len(SMPL))]).astype(np.uint32).astype(np.int64),
    )  # fmt: skip


def write_behave(root: Path, sequences: Sequence[str], frames: int = 2) -> Path:
    """Writes ``root/behave`` with ``Date_Sub_OBJECT_ACTION`` sequences, and body models beside it; returns ``root``."""
    behave = root / "behave"
    write_body_model(root / "smplh")
    colour = {"fx": FOCAL, "fy": FOCAL, "cx": WIDTH / 2 - 0.5, "cy": HEIGHT / 2 - 0.5, "width": WIDTH, "height": HEIGHT}
    colour["opencv"] = [FOCAL, FOCAL, colour["cx"], colour["cy"], *[0.0] * 8]  # type: ignore[assignment]
    for kinect in KINECTS:
        _write_json(behave / f"calibs/intrinsics/{kinect}/calibration.json", {"color": colour})
        for date in {name.split("_")[0] for name in sequences}:
            pose = {"rotation": np.eye(3).reshape(-1).tolist(), "translation": [_camera_x(kinect), 0.0, 0.0]}
            _write_json(behave / f"calibs/{date}/config/{kinect}/config.json", pose)
    for thing in {name.split("_")[2] for name in sequences}:
        corners = "\n".join(" ".join(map(str, corner)) for corner in _corners())
        properties = "\n".join(f"property float {axis}" for axis in "xyz")
        file = behave / "objects" / thing / f"{thing}_f1000.ply"
        file.parent.mkdir(parents=True)
        file.write_text(f"ply\nformat ascii 1.0\nelement vertex 8\n{properties}\nend_header\n{corners}\n")
    for number, name in enumerate(sequences):
        _write_sequence(behave / "sequences" / name, number, frames)
    return root


def _write_sequence(folder: Path, number: int, frames: int) -> None:
    date, _, thing = folder.name.split("_")[:3]
    _write_json(
        folder / "info.json",
        {"config": f"../../calibs/{date}/config", "intrinsic": "../../calibs/intrinsics", "cat": thing,
         "gender": "male", "kinects": list(KINECTS)},
    )  # fmt: skip
    for frame in range(frames):
        moved = 0.05 * np.array([np.sin(number + frame), np.cos(2.0 * number + frame), 0.0])
        body, place = np.array([0.0, 0.0, 2.5]) + moved, np.array([0.1, 0.3, 2.0]) - moved
        where = folder / f"t{3 + frame:04d}.000"
        _write_fit(where / "person/fit02/person_fit.pkl", {"pose": np.zeros(156), "betas": np.zeros(2), "trans": body})
        _write_fit(where / f"{thing}/fit01/{thing}_fit.pkl", {"angle": np.zeros(3), "trans": place})
        for kinect in KINECTS:
            _draw(where, kinect, body_joints() + body, _corners() + place)


def _draw(folder: Path, kinect: int, joints: np.ndarray, corners: np.ndarray) -> None:
    """Colour and masks of one Kinect; the person hides the object."""
    person, thing = Image.new("L", (WIDTH, HEIGHT)), Image.new("L", (WIDTH, HEIGHT))
    box = _projected(corners, kinect)
    ImageDraw.Draw(thing).polygon([tuple(box[index]) for index in ConvexHull(box).vertices], fill=255)
    for (x, y), depth in zip(_projected(joints, kinect), joints[:, 2], strict=True):
        radius = FOCAL * DISC / depth
        ImageDraw.Draw(person).ellipse((x - radius, y - radius, x + radius, y + radius), fill=255)
    shown = np.asarray(person) > 0
    held = (np.asarray(thing) > 0) & ~shown
    rgb = np.where(shown[..., None], (200, 100, 50), np.where(held[..., None], (40, 90, 200), (0, 0, 0)))
    for name, array in (("color", rgb), ("person_mask", shown * 255), ("obj_rend_mask", held * 255)):
        Image.fromarray(array.astype(np.uint8)).save(folder / f"k{kinect}.{name}.jpg", quality=95)


def _projected(points: np.ndarray, kinect: int) -> np.ndarray:
    local = points - np.array([_camera_x(kinect), 0.0, 0.0])
    return FOCAL * local[:, :2] / local[:, 2:] + np.array([WIDTH / 2, HEIGHT / 2]) - 0.5


def _camera_x(kinect: int) -> float:
    return 0.3 * (1 - kinect)


def _corners() -> np.ndarray:
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * HALF


def _write_json(file: Path, content: dict) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content))


def _write_fit(file: Path, content: dict) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(pickle.dumps(content, protocol=2))

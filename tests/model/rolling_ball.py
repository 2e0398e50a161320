"""A model and a shot whose frames take a tenth of a second: bakes of it are killed, left and found again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from ball_model import ball_actor
from scene_files import write_poses
from tiny_capture import tiny_cameras

from chona_model.data.dataset import Pose
from chona_model.model_store import save_actor


def write_rolling_ball(folder: Path, frames: int) -> tuple[Path, Path]:
    """A model of one object, and the shot ``walk`` in which it rolls by."""
    model = folder / "model.safetensors"
    save_actor(model, ball_actor(), "chona", {}, {})
    poses = []
    for place in np.linspace(-0.4, 0.4, frames):
        frame = np.eye(4)[None].copy()
        frame[0, 0, 3] = place
        poses.append(Pose(None, ("ball",), np.zeros((0, 4, 4)), frame))
    return model, write_poses(folder / "roll.shot.npz", tiny_cameras(1, (320, 240))[0], poses)

"""Files for the command line's tests: a tiny capture on the disk, a shot of it, and model files of headers alone."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
from tiny_capture import SKELETON, tiny_cameras, tiny_capture, tiny_pose

from chona_model.data.dataset import Dataset, View
from chona_model.formats.shot import Shot, ShotActor, write_shot

SEQUENCE = "Date01_Sub01_box01"
FIRST_FRAME = -1
"""Shots begin before frame 0: negative frames are ordinary."""


def write_capture(folder: Path, frames: int = 2, cameras: int = 2) -> Path:
    """``tiny_capture`` in the layout of a captured Blender scene."""
    dataset = tiny_capture(folder / "drawn", frames=frames, cameras=cameras)
    sequence = folder / "sequences" / SEQUENCE
    numbers = {frame: index + 1 for index, frame in enumerate(dict.fromkeys(view.frame for view in dataset.views))}
    for view in dataset.views:
        target = sequence / f"{numbers[view.frame]:04d}"
        target.mkdir(parents=True, exist_ok=True)
        for source, kind in (
            (view.image, "color"),
            (view.person_mask, "person_mask"),
            (view.object_mask, "object_mask"),
        ):
            shutil.copy(source, target / f"{view.camera_name}.{kind}.png")
    shutil.rmtree(folder / "drawn")
    _write_poses(sequence / "poses.npz", dataset, list(numbers.values()), cameras)
    person, thing = dataset.persons["Sub01"], dataset.objects["box01"]
    content = {
        "format": "chona-capture", "version": 1,
        "skeleton": {"names": SKELETON.names, "parents": SKELETON.parents},
        "persons": {"Sub01": {"rest_joints": person.rest_joints.tolist()}},
        "objects": {"box01": {"lower": thing.lower.tolist(), "upper": thing.upper.tolist()}},
        "sequences": [{"name": SEQUENCE, "person": "Sub01", "objects": ["box01"],
                       "cameras": [f"k{index}" for index in range(cameras)], "width": 32, "height": 24}],
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(content), "utf-8")
    return folder


def _write_poses(path: Path, dataset: Dataset, numbers: list[int], cameras: int) -> None:
    first = [view for view in dataset.views if view.camera_name == "k0"]
    rigs = [[view.camera for view in dataset.views if view.camera_name == f"k{index}"] for index in range(cameras)]
    np.savez(
        path,
        frames=np.array(numbers),
        world_from_bone=np.stack([view.pose.world_from_bone for view in first]),
        world_from_object=np.stack([view.pose.world_from_object for view in first]),
        intrinsics=np.array([[camera.intrinsics for camera in row] for row in rigs]),
        world_from_camera=np.array([[camera.world_from_camera for camera in row] for row in rigs]),
    )


def write_tiny_shot(path: Path, capture: Path, frames: int = 3, person: str = "Sub01") -> Path:
    """A shot of ``frames`` frames from ``FIRST_FRAME`` on, of the capture's person and object."""
    from chona_model.data.opener import open_dataset

    dataset = open_dataset(capture)
    poses = [tiny_pose(dataset.persons["Sub01"], "box01", index) for index in range(frames)]
    camera = tiny_cameras(1)[0]
    actor = ShotActor(
        "actor", person, ("box01",), SKELETON.names,
        np.stack([pose.world_from_bone for pose in poses]), np.stack([pose.world_from_object for pose in poses]),
    )  # fmt: skip
    shot = Shot(
        "walk", 24.0, camera.width, camera.height, camera.kind, np.arange(FIRST_FRAME, FIRST_FRAME + frames),
        np.stack([camera.intrinsics] * frames), np.stack([camera.world_from_camera] * frames),
        np.array([[0.01, 100.0]] * frames), (actor,),
    )  # fmt: skip
    write_shot(path, shot)
    return path


def write_header(path: Path, **changes: Any) -> Path:
    """A safetensors file without tensors whose metadata is a model's, with ``changes``."""
    content = {
        "format": "chona-model", "version": 1, "method": "chona", "field": "grid",
        "skeleton": {"names": ["hips", "chest"], "parents": [-1, 0]},
        "persons": {"Sub01": {"rest_joints": [[0.0, 0.0, 0.0], [0.0, 0.4, 0.0]]}},
        "objects": {"box01": {"lower": [-0.1, -0.2, -0.3], "upper": [0.1, 0.2, 0.3]}},
        "object_distance": 1.5, "settings": {"preset": "fast"}, "training": {"steps": 7, "data": "a capture"},
        "shape": {}, **changes,
    }  # fmt: skip
    text = json.dumps({"__metadata__": {"chona": json.dumps(content)}}).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text)
    return path


def write_view_shot(path: Path, view: View) -> Path:
    """A shot of one frame: what a view shows, seen by its camera."""
    pose, camera = view.pose, view.camera
    actor = ShotActor(
        "actor", pose.person, pose.objects, SKELETON.names, pose.world_from_bone[None], pose.world_from_object[None]
    )
    shot = Shot(
        "still", 24.0, camera.width, camera.height, camera.kind, np.array([1]), camera.intrinsics[None],
        camera.world_from_camera[None], np.array([[0.01, 100.0]]), (actor,),
    )  # fmt: skip
    write_shot(path, shot)
    return path

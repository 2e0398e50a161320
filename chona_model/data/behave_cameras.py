"""Cameras of BEHAVE: where a sequence's calibration lies, and what it means."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from chona_model.camera import Camera, CameraError, is_rotation, rigid
from chona_model.data.dataset import DatasetError
from chona_model.data.lens import Lens
from chona_model.data.reading import json_object, real_numbers

UPRIGHT = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Our world from BEHAVE's: x stays, down becomes −z, forward becomes y."""

LONGEST_PATH = 1000


def read_camera(root: Path, folder: Path, info: Mapping[str, Any], kinect: int) -> tuple[Camera, Lens | None]:
    """A Kinect's colour camera in this package's world, and its lens.

    Args:
        root: the data set's folder.
        folder, info: a sequence's, and its info.json, which may name where its calibration lies.

    Raises:
        DatasetError: there is no calibration, or it is damaged.
    """
    intrinsics = _calibration_file(root, folder, info, "intrinsic", f"{kinect}/calibration.json", "calibs/intrinsics")
    date = folder.name.split("_")[0]
    pose = _calibration_file(root, folder, info, "config", f"{kinect}/config.json", f"calibs/{date}/config")
    try:
        color = json_object(intrinsics, "the colour camera's intrinsics")["color"]
        stated = json_object(pose, "the camera's rotation and translation")
        # BEHAVE puts the centre of the first pixel at 0, this package at 0.5.
        matrix = real_numbers(
            [[color["fx"], 0.0, color["cx"] + 0.5], [0.0, color["fy"], color["cy"] + 0.5], [0.0, 0.0, 1.0]]
        )
        rotation = real_numbers(stated["rotation"]).reshape(3, 3)
        world_from_camera = rigid(rotation, real_numbers(stated["translation"]))
        lens = Lens.opencv(real_numbers(color.get("opencv", [])[4:]))  # behind fx, fy, cx, cy
        width, height = int(color["width"]), int(color["height"])
        if not is_rotation(rotation):
            raise CameraError("the rotation is not one (to 0.001)")
        camera = Camera(matrix, UPRIGHT @ world_from_camera, width, height)
    except (KeyError, TypeError, ValueError, OverflowError, CameraError) as error:
        raise DatasetError(
            f"the calibration in {intrinsics} and {pose} is not BEHAVE's: {type(error).__name__} {error}; expected "
            "color.fx, fy, cx, cy, width, height, and rotation [9] (camera to world, row by row), translation [3]"
        ) from error
    return camera, lens


def _calibration_file(root: Path, folder: Path, info: Mapping[str, Any], key: str, name: str, usual: str) -> Path:
    """info.json names calibrations relative to its folder, to the root, or where its authors once had them.

    What it names outside of the root is passed over.
    """
    stated = info.get(key)
    places = [folder / stated, root / stated] if isinstance(stated, str) and len(stated) < LONGEST_PATH else []
    for place in (*(place for place in places if _within(place, root)), root / usual):
        if (place / name).is_file():
            return place / name
    raise DatasetError(
        f"{folder.name} has no calibration {name}: looked in {', '.join(str(p) for p in (*places, root / usual))}; "
        "copy BEHAVE's folder 'calibs' beside 'sequences'"
    )


def _within(place: Path, root: Path) -> bool:
    """Whether a place lies in the root once '..' and links are followed; not where it can be no path."""
    try:
        return place.resolve().is_relative_to(root.resolve())
    except (OSError, ValueError):
        return False

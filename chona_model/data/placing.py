"""Static objects scanned with a moving camera get a place, an upright direction and a size.

Structure from motion leaves an arbitrary origin, orientation and scale.  Here the object's centre becomes the origin,
the cameras' mean upward direction becomes z, and the object's longest side becomes a stated number of metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from chona_model.camera import Camera, rigid
from chona_model.data.dataset import DatasetError, ObjectShape, Pose, View
from chona_model.data.images import load_pixels

LONGEST_SIDE = 0.5
"""Metres of an object's longest side where nobody says otherwise."""
MARGIN = 0.05
"""An object's box is larger than what was found by this share of its longest side, to every side."""
STRAYS = 0.005
"""Share of a point cloud's points dropped at either end of each axis: clouds of real scans have strays."""
HULL_CELLS = (32, 64)
"""Cells along each axis of the visual hull, first and when its cube has been tightened."""
HULL_SHARE = 0.95
"""A cell belongs to the hull when it falls into the masks of this share of the views that see it."""
HULL_SEEN = 0.5
"""… and when this share of all views sees it: what one view alone sees cannot be carved."""
HULL_VIEWS = 48
"""Views that the hull is carved from, spread over all."""


@dataclass(frozen=True)
class Placing:
    """From the scan's world to ours: ``x = scale · upright · (x_scan − centre)``.

    Attributes:
        centre: [3] in the scan's world; upright: [3, 3] rotation; scale: metres per unit of the scan.
        lower, upper: [3] the object's box in our world, metres, margin included.
    """

    centre: np.ndarray
    upright: np.ndarray
    scale: float
    lower: np.ndarray
    upper: np.ndarray

    def camera(self, scanned: Camera) -> Camera:
        """The same view in our world."""
        turned = self.upright @ scanned.world_from_camera[:3, :3]
        origin = self.scale * (self.upright @ (scanned.world_from_camera[:3, 3] - self.centre))
        return replace(scanned, world_from_camera=rigid(turned, origin))

    def shape(self, name: str) -> ObjectShape:
        """The object with its box, its frame at the world's origin."""
        return ObjectShape(name, self.lower, self.upper)


def static_pose(name: str) -> Pose:
    """An object alone at the world's origin."""
    return Pose(None, (name,), np.empty((0, 4, 4)), np.eye(4)[None])


def place(cameras: Sequence[Camera], points: np.ndarray, longest_side: float, strays: float = 0.0) -> Placing:
    """A placing that puts ``points`` [P, 3] of the scan's world around the origin.

    Args:
        strays: share of the points that is dropped at either end of each axis.

    Raises:
        DatasetError: the points have no extent, or ``longest_side`` is not positive.
    """
    if not (np.isfinite(longest_side) and longest_side > 0.0):
        raise DatasetError(f"the object's longest side is {longest_side} m, expected a positive length")
    upright = _upright(cameras)
    turned = points @ upright.T
    low, high = np.quantile(turned, strays, axis=0), np.quantile(turned, 1.0 - strays, axis=0)
    longest = float((high - low).max())
    if not longest > 0.0:
        raise DatasetError(f"the {len(points)} points of the object lie in one place; expected a point cloud")
    scale = longest_side / longest
    half = 0.5 * scale * (high - low) + MARGIN * longest_side
    return Placing(upright.T @ (0.5 * (low + high)), upright, scale, -half, half)


def hull_points(views: Sequence[View]) -> np.ndarray:
    """[P, 3] cells of the object masks' visual hull in the views' world, for scans without a point cloud.

    The first cube lies around the point that all cameras look at; it is carved, tightened around what is left, and
    carved again.

    Raises:
        DatasetError: fewer than three views, or masks that have no common inside.
    """
    if len(views) < 3:
        raise DatasetError(f"a scan has {len(views)} views, expected at least 3 to find out where the object is")
    chosen = [views[int(k)] for k in np.unique(np.linspace(0, len(views) - 1, HULL_VIEWS).round())]
    masks = [load_pixels(view).object for view in chosen]
    cameras = [view.camera for view in chosen]
    middle, half = _looked_at(cameras)
    points = np.empty((0, 3))
    for cells in HULL_CELLS:
        axis = (np.arange(cells) + 0.5) / cells * 2.0 - 1.0
        grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        points = _carved(middle + half * grid, cameras, masks)
        if not len(points):
            raise DatasetError("the object's masks have no common inside; check the cameras with 'chona check-data'")
        low, high = points.min(axis=0), points.max(axis=0)
        middle, half = 0.5 * (low + high), 0.5 * float((high - low).max()) + 2.0 * half / cells
    return points


def _upright(cameras: Sequence[Camera]) -> np.ndarray:
    """[3, 3] rotation that takes the cameras' mean upward direction to z."""
    up = -np.mean([camera.world_from_camera[:3, 1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(up))
    if length < 1e-6:  # as many cameras hang upside down as stand
        return np.eye(3)
    up = up / length
    side = np.cross(np.eye(3)[int(np.abs(up).argmin())], up)
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(up, side), up])


def _looked_at(cameras: Sequence[Camera]) -> tuple[np.ndarray, float]:
    """The point nearest to all optical axes (least squares), and half the mean distance to it."""
    origins = np.array([camera.world_from_camera[:3, 3] for camera in cameras])
    axes = np.array([camera.world_from_camera[:3, 2] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = np.linalg.lstsq(across.sum(axis=0), np.einsum("kij,kj->i", across, origins), rcond=None)[0]
    return middle, 0.5 * float(np.linalg.norm(origins - middle, axis=1).mean())


def _carved(points: np.ndarray, cameras: Sequence[Camera], masks: Sequence[np.ndarray]) -> np.ndarray:
    inside, seen = np.zeros(len(points), np.int32), np.zeros(len(points), np.int32)
    for camera, mask in zip(cameras, masks, strict=True):
        pixels, depth = camera.project(points)
        column, row = np.floor(pixels).astype(np.int64).T
        within = (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        seen += within
        inside[within] += mask[row[within], column[within]]
    return points[(seen >= HULL_SEEN * len(cameras)) & (inside >= HULL_SHARE * seen)]

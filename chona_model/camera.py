"""Cameras: OpenCV axes (x right, y down, z forward), pixel centres at +0.5, metres.

``intrinsics`` maps camera coordinates to pixels: ``u = fx x / z + cx`` for a perspective camera and ``u = fx x + cx``
(fx in pixels a metre) for an orthographic one.  Poses are kept in float64: a figure may stand 10 km from the origin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

PERSPECTIVE = "PERSP"
ORTHOGRAPHIC = "ORTHO"


FARTHEST = 1e8
"""Metres from the origin, and pixels of a focal length or principal point: beyond, nothing is told apart any more."""


class CameraError(ValueError):
    """A camera that cannot be rendered: singular, not finite, or of an unknown kind."""


@dataclass(frozen=True)
class Camera:
    """One camera at one moment.

    Attributes:
        intrinsics: [3, 3] pixels; the last row is (0, 0, 1).
        world_from_camera: [4, 4] rigid, metres, OpenCV axes.
        width, height: image size in pixels.
        kind: ``PERSP`` or ``ORTHO``.
    """

    intrinsics: np.ndarray
    world_from_camera: np.ndarray
    width: int
    height: int
    kind: str = PERSPECTIVE

    def __post_init__(self) -> None:
        if self.kind not in (PERSPECTIVE, ORTHOGRAPHIC):
            raise CameraError(f"camera kind is '{self.kind}', expected {PERSPECTIVE} or {ORTHOGRAPHIC}")
        if self.width < 1 or self.height < 1:
            raise CameraError(f"image size is {self.width}x{self.height}, expected at least 1x1")
        if not (np.isfinite(self.intrinsics).all() and np.isfinite(self.world_from_camera).all()):
            raise CameraError("the camera holds a value that is not finite")
        largest = max(np.abs(self.intrinsics).max(), np.abs(self.world_from_camera).max())
        if largest > FARTHEST:
            raise CameraError(f"the camera holds the value {largest:g}, expected at most {FARTHEST:g}")
        if self.intrinsics[0, 0] <= 0 or self.intrinsics[1, 1] <= 0:
            raise CameraError(
                f"focal lengths must be positive, got {self.intrinsics[0, 0]} and {self.intrinsics[1, 1]}"
            )

    def scaled(self, scale: float) -> Camera:
        """The same view on an image of ``round(size · scale)`` pixels, at least 1x1."""
        return self.resized(max(1, round(self.width * scale)), max(1, round(self.height * scale)))

    def resized(self, width: int, height: int) -> Camera:
        """The same view on an image of so many pixels."""
        stretch = np.diag([width / self.width, height / self.height, 1.0])
        return Camera(stretch @ self.intrinsics, self.world_from_camera, width, height, self.kind)

    def shifted(self, pixels: np.ndarray) -> Camera:
        """The same view whose pixel (0, 0) is what was at ``pixels`` [2]: rays go through other points of pixels."""
        intrinsics = self.intrinsics.copy()
        intrinsics[:2, 2] -= pixels
        return replace(self, intrinsics=intrinsics)

    def through(self, point: np.ndarray, focus: float) -> Camera:
        """The view from a point of the lens: what lies in focus stays where it is in the picture.

        A perspective camera moves by ``point`` with a shifted principal point.  An orthographic one looks along the way
        from ``point`` to where the axis meets the plane in focus: an oblique projection, written as a camera that is
        turned that way, with a skew.

        Args:
            point: [2] metres right and down from the lens's centre; focus: metres along the axis to what is sharp.
        """
        if not np.any(point):
            return self
        across = np.array([point[0], point[1], 0.0])
        placed = self.world_from_camera.copy()
        if self.kind == PERSPECTIVE:
            intrinsics = self.intrinsics.copy()
            intrinsics[:2, 2] += intrinsics[:2, :2] @ point / focus
            placed[:3, 3] += placed[:3, :3] @ across
            return replace(self, intrinsics=intrinsics, world_from_camera=placed)
        # Pixels are linear in points, and what lies along the view ray is on one pixel: u = A x with A d = 0.
        towards = np.array([-point[0], -point[1], focus])
        towards /= np.linalg.norm(towards)
        linear = self.intrinsics[:2, :2] @ np.array(
            [[1.0, 0.0, -towards[0] / towards[2]], [0.0, 1.0, -towards[1] / towards[2]]]
        )
        # RQ decomposition: rows of the turned camera's axes such that A is upper triangular in them.
        down = linear[1] / np.linalg.norm(linear[1])
        right = np.cross(down, towards)
        placed[:3, :3] = placed[:3, :3] @ np.stack([right, down, towards], axis=1)
        placed[:3, 3] += self.world_from_camera[:3, :3] @ across
        intrinsics = self.intrinsics.copy()
        intrinsics[:2, :2] = [[linear[0] @ right, linear[0] @ down], [0.0, linear[1] @ down]]
        return replace(self, intrinsics=intrinsics, world_from_camera=placed)

    def project(self, points_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels [..., 2] and depths along the camera axis [...] of world points [..., 3].

        Perspective pixels of points at depth zero or behind the camera are meaningless: check the depth.
        """
        rotation, origin = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        points = (np.asarray(points_world, dtype=np.float64) - origin) @ rotation
        depth = points[..., 2]
        if self.kind == PERSPECTIVE:
            scale = np.where(np.abs(depth) > 1e-12, depth, 1e-12)
            points = points / scale[..., None]
        else:
            points = np.concatenate([points[..., :2], np.ones_like(points[..., :1])], axis=-1)
        return points @ self.intrinsics[:2].T, depth

    def rays(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions of the rays through ``pixels`` [..., 2] (centre of the first pixel: 0.5, 0.5).

        Directions have unit length *along the camera axis*, not Euclidean: a point at distance ``t`` along the ray has
        depth ``t``, which is the depth Blender and the EXR's Z channel mean.

        Returns:
            origins, directions, each [..., 3] in world space, float64.
        """
        homogeneous = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
        local = homogeneous @ np.linalg.inv(self.intrinsics).T
        rotation, origin = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        if self.kind == PERSPECTIVE:
            local[..., 2] = 1.0
            return np.broadcast_to(origin, local.shape), local @ rotation.T
        local[..., 2] = 0.0
        return origin + local @ rotation.T, np.broadcast_to(rotation[:, 2], local.shape)

    def pixel_centres(self) -> np.ndarray:
        """[height, width, 2] pixel coordinates of all centres."""
        columns, rows = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([columns, rows], axis=-1)


def rigid(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """[4, 4] float64 of a rotation [3, 3] and a translation [3]."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def is_rotation(matrix: np.ndarray, tolerance: float = 1e-3) -> bool:
    """Whether a matrix [3, 3] is one, to ``tolerance`` in every entry of RᵀR − I; what is not finite is none."""
    if not (np.abs(matrix) <= 2.0).all():
        return False
    return bool(np.abs(matrix @ matrix.T - np.eye(3)).max() <= tolerance and np.linalg.det(matrix) > 0.0)

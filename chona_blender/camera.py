"""Cameras as Blender renders them, in OpenCV axes with pixel centres at +0.5.

Intrinsics are read off the projection matrix that Blender itself uses, so lens shift, sensor fit, pixel aspect and
resolution percentage are right by construction.  A border crops only where the scene says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bpy.types import Depsgraph, Object, Scene

from .blur import LensSample, sample_lens
from .errors import ChonaError

OPENCV_FROM_BLENDER = np.diag([1.0, -1.0, -1.0, 1.0])
"""Blender's cameras look down −z with y up."""


@dataclass(frozen=True)
class ImageFormat:
    """The pixels of a render.

    Attributes:
        full_width, full_height: the whole frame, pixels.
        aspect_x, aspect_y: pixel aspect.
        left, top: the image's corner in the whole frame, pixels.
        width, height: the image, pixels.
    """

    full_width: int
    full_height: int
    aspect_x: float
    aspect_y: float
    left: int
    top: int
    width: int
    height: int

    @staticmethod
    def plain(width: int, height: int) -> ImageFormat:
        """An image of square pixels without a border."""
        return ImageFormat(width, height, 1.0, 1.0, 0, 0, width, height)


@dataclass(frozen=True)
class CameraSample:
    """One camera in one frame.

    Attributes:
        intrinsics: [3, 3]; pixels (perspective) or pixels per metre (orthographic).
        world_from_camera: [4, 4] rigid, OpenCV axes, metres.
        clip: [2] near and far along the camera axis, metres.
        kind: ``PERSP`` or ``ORTHO``.
        lens: what depth of field there is.
    """

    intrinsics: np.ndarray
    world_from_camera: np.ndarray
    clip: np.ndarray
    kind: str
    lens: LensSample


def image_format(scene: Scene) -> ImageFormat:
    """The pixels that rendering ``scene`` would give, border and cropping included.

    Raises:
        ChonaError: a cropping border without area.
    """
    render = scene.render
    full_width = max(1, render.resolution_x * render.resolution_percentage // 100)
    full_height = max(1, render.resolution_y * render.resolution_percentage // 100)
    left, right, bottom, top = 0, full_width, 0, full_height
    if render.use_border and render.use_crop_to_border:
        # Blender multiplies in single precision and drops the fraction: 0.9 of 120 pixels must be 108, not 107.
        borders = (render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y)
        sizes = (full_width, full_width, full_height, full_height)
        left, right, bottom, top = (
            int(np.float32(border) * np.float32(size)) for border, size in zip(borders, sizes, strict=True)
        )
        if right <= left or top <= bottom:
            raise ChonaError(
                f"The render border of scene '{scene.name}' is {right - left}x{top - bottom} pixels. Enlarge it or "
                "switch 'Crop to Render Region' off"
            )
    return ImageFormat(
        full_width,
        full_height,
        render.pixel_aspect_x,
        render.pixel_aspect_y,
        left,
        full_height - top,
        right - left,
        top - bottom,
    )


def scene_camera(scene: Scene, frame: int) -> Object:
    """The camera that Blender renders ``frame`` with: the timeline's markers first, then the scene's camera.

    Raises:
        ChonaError: there is none.
    """
    bound = [marker for marker in scene.timeline_markers if marker.camera and not marker.camera.hide_render]
    if bound:
        past = [marker for marker in bound if marker.frame <= frame]
        if past:
            return max(past, key=lambda marker: marker.frame).camera
        return min(bound, key=lambda marker: marker.frame).camera
    if scene.camera is None:
        raise ChonaError(f"Scene '{scene.name}' has no camera. Add one and make it the scene's active camera")
    return scene.camera


def camera_kind(camera: Object) -> str:
    """``PERSP`` or ``ORTHO``.

    Raises:
        ChonaError: not a camera, or one of another kind (panoramic, custom).
    """
    if camera.type != "CAMERA":
        raise ChonaError(f"'{camera.name}' is a {camera.type.lower()}, expected a camera. Choose a camera")
    if camera.data.type not in {"PERSP", "ORTHO"}:
        kind = {"PANO": "panoramic"}.get(camera.data.type, camera.data.type.lower())
        raise ChonaError(
            f"Camera '{camera.name}' is {kind}; only perspective and orthographic cameras can be rendered. Change its "
            "lens type"
        )
    return camera.data.type


def rigid_camera(camera: Object, matrix: np.ndarray) -> np.ndarray:
    """``world_from_camera`` [4, 4] in OpenCV axes from Blender's ``matrix_world``; scale is ignored as Blender does.

    Raises:
        ChonaError: zero scale, sheared, mirrored or not finite.
    """
    matrix = np.array(matrix, dtype=np.float64)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or lengths.min() < 1e-9:
        raise ChonaError(
            f"Camera '{camera.name}' has a scale of zero or a value that is not finite. Set its scale to 1"
        )
    rotation = matrix[:3, :3] / lengths
    if np.linalg.det(rotation) < 0:
        raise ChonaError(f"Camera '{camera.name}' is mirrored (a negative scale). Set its scale to 1")
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-3:
        raise ChonaError(f"Camera '{camera.name}' is sheared by a scaled parent. Clear the parent's scale")
    left, _, right = np.linalg.svd(rotation)
    matrix[:3, :3] = left @ right
    return matrix @ OPENCV_FROM_BLENDER


def sample_camera(camera: Object, depsgraph: Depsgraph, image: ImageFormat) -> CameraSample:
    """The evaluated camera in the depsgraph's frame.

    Raises:
        ChonaError: see ``camera_kind`` and ``rigid_camera``.
    """
    evaluated = camera.evaluated_get(depsgraph)
    kind = camera_kind(evaluated)
    width, height = image.full_width, image.full_height
    projection = np.array(
        evaluated.calc_matrix_camera(depsgraph, x=width, y=height, scale_x=image.aspect_x, scale_y=image.aspect_y),
        dtype=np.float64,
    )
    # Blender: clip = P q with q = (x, −y, −z) of OpenCV; pixels are ((1 + ndc_x) w / 2, (1 − ndc_y) h / 2).
    if kind == "PERSP":
        centre = np.array([1.0 - projection[0, 2], 1.0 + projection[1, 2]])
    else:
        centre = np.array([1.0 + projection[0, 3], 1.0 - projection[1, 3]])
    half = np.array([width / 2.0, height / 2.0])
    intrinsics = np.eye(3)
    intrinsics[[0, 1], [0, 1]] = half * projection[[0, 1], [0, 1]]
    intrinsics[:2, 2] = half * centre - np.array([image.left, image.top])
    clip = np.array([evaluated.data.clip_start, evaluated.data.clip_end], dtype=np.float64)
    if not clip[0] < clip[1]:
        raise ChonaError(
            f"Camera '{camera.name}' clips from {clip[0]:g} m to {clip[1]:g} m. Set its clip end beyond its clip start"
        )
    lens = sample_lens(evaluated, depsgraph)
    return CameraSample(intrinsics, rigid_camera(camera, evaluated.matrix_world), clip, kind, lens)

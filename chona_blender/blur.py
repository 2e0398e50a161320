"""Motion blur and depth of field as the scene has them: the moments of the shutter, and the camera's lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bpy.types import CurveMapping, Depsgraph, Object, Scene

from .errors import ChonaError

OPENS = {"START": 0.0, "CENTER": -0.5, "END": -1.0}
"""When the shutter opens, in shutter times from the frame, by ``motion_blur_position``."""

MOMENTS_PER_SAMPLE = 2
"""Moments of the shutter for every ray of a pixel: neighbouring pixels see others of them."""

CURVE_STEPS = 256
"""Pieces in which the shutter's curve is taken, as Cycles takes it."""


@dataclass(frozen=True)
class SceneBlur:
    """What of the scene's blur a shot takes along.

    Attributes:
        times: [T] moments while the shutter is open, frames from the frame's own; none: no motion blur.
        lens: whether cameras' depth of field counts.
        samples: rays a pixel.
    """

    times: np.ndarray
    lens: bool
    samples: int


@dataclass(frozen=True)
class LensSample:
    """The lens of a camera in one frame, in lengths of the scene.

    Attributes:
        focus_distance: along the camera axis; radius: of the aperture, 0 where depth of field is off.
        blades: corners of the aperture; rotation: of them, radians; ratio: height over width.
    """

    focus_distance: float
    radius: float
    blades: int
    rotation: float
    ratio: float


NO_LENS = LensSample(1.0, 0.0, 0, 0.0, 1.0)
"""Everything is sharp."""


def scene_blur(scene: Scene) -> SceneBlur | None:
    """What of a scene's blur its bake takes along; None: frames are sharp.

    Raises:
        ChonaError: the shutter's curve lets no light in.
    """
    settings, render = scene.chona.blur, scene.render
    motion = settings.use_motion_blur and render.use_motion_blur and render.motion_blur_shutter > 0.0
    if not motion and not settings.use_depth_of_field:
        return None
    times = shutter_times(scene, MOMENTS_PER_SAMPLE * settings.samples) if motion else np.zeros(0)
    return SceneBlur(times, settings.use_depth_of_field, settings.samples)


def shutter_times(scene: Scene, count: int) -> np.ndarray:
    """[count] moments of equal light while the scene's shutter is open, frames from the frame's own.

    Raises:
        ChonaError: the shutter's curve lets no light in.
    """
    render = scene.render
    open_for, opens = render.motion_blur_shutter, OPENS[render.motion_blur_position]
    return open_for * (opens + _moments_of_equal_light(render.motion_blur_shutter_curve, count, scene.name))


def _moments_of_equal_light(curve: CurveMapping, count: int, scene_name: str) -> np.ndarray:
    """[count] shares of the shutter time at which as much light has come in as lies between any two of them."""
    curve.initialize()
    shares = np.linspace(0.0, 1.0, CURVE_STEPS + 1)
    light = np.array([max(curve.evaluate(curve.curves[0], share), 0.0) for share in shares])
    total = np.concatenate([[0.0], np.cumsum(0.5 * (light[1:] + light[:-1]))])
    if total[-1] <= 0.0:
        raise ChonaError(
            f"The shutter curve of scene '{scene_name}' is zero everywhere, so no light comes in. Reset it under "
            "Motion Blur in the render properties"
        )
    return np.interp((np.arange(count) + 0.5) / count, total / total[-1], shares)


def sample_lens(camera: Object, depsgraph: Depsgraph) -> LensSample:
    """The lens of an evaluated camera as Cycles takes it; ``NO_LENS`` where depth of field is off."""
    lens = camera.data.dof
    if not lens.use_dof:
        return NO_LENS
    # Cycles: the f-stop is of the focal length, and of a metre where there is none.
    length = camera.data.lens * 1e-3 if camera.data.type == "PERSP" else 1.0
    radius = length / (2.0 * max(lens.aperture_fstop, 1e-5))
    distance = _focus_distance(camera, depsgraph)
    return LensSample(distance, radius, lens.aperture_blades, lens.aperture_rotation, lens.aperture_ratio)


def _focus_distance(camera: Object, depsgraph: Depsgraph) -> float:
    """Along the camera's axis, to the focus object or one of its bones where there is one."""
    lens = camera.data.dof
    if lens.focus_object is None:
        return lens.focus_distance
    target = lens.focus_object.evaluated_get(depsgraph)
    place = target.matrix_world
    if target.pose is not None and lens.focus_subtarget in target.pose.bones:
        place = place @ target.pose.bones[lens.focus_subtarget].matrix
    axis = camera.matrix_world.to_3x3().col[2].normalized()
    return abs(axis.dot(camera.matrix_world.translation - place.translation))

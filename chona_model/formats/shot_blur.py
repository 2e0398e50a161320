"""What of a shot blurs: the moments while the shutter is open, and the lens. Absent where nothing does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from chona_model.formats.shot_checks import ShotError, check_intrinsics, check_rigid, check_shape
from chona_model.plain_json import shortened
from chona_model.settings import MOST_BLUR_SAMPLES

LARGEST = 1e8
"""Metres, corners, radians or frames of a lens or a shutter: beyond, it is damage."""

MOST_TIMES = 1024
"""Moments that a shutter is open over."""

LENS_FIELDS = ("focus_distance", "radius", "blades", "rotation", "ratio")


class Member(Protocol):
    """What is asked of an actor of the shot here."""

    @property
    def name(self) -> str: ...
    @property
    def objects(self) -> tuple[str, ...]: ...
    @property
    def bones(self) -> tuple[str, ...]: ...


@dataclass(frozen=True)
class Shutter:
    """Cameras and poses at T moments of each of F frames, all of the same weight.

    Attributes:
        times: [T] frames from the frame's own time, increasing.
        intrinsics: [F, T, 3, 3]; world_from_camera: [F, T, 4, 4], as in ``Shot``.
        world_from_bone, world_from_object: of every actor [F, T, B, 4, 4] and [F, T, N, 4, 4].
    """

    times: np.ndarray
    intrinsics: np.ndarray
    world_from_camera: np.ndarray
    world_from_bone: tuple[np.ndarray, ...]
    world_from_object: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Lens:
    """The lens of the camera, by frame.

    Attributes:
        focus_distance: [F] metres along the camera axis to the plane that is sharp.
        radius: [F] of the aperture, metres; 0: everything is sharp.
        blades: [F] corners of the aperture; fewer than 3: a circle.
        rotation: [F] of the blades, radians, against the clock as the camera looks.
        ratio: [F] height over width of the aperture.
    """

    focus_distance: np.ndarray
    radius: np.ndarray
    blades: np.ndarray
    rotation: np.ndarray
    ratio: np.ndarray


def shutter_arrays(shutter: Shutter) -> dict[str, np.ndarray]:
    """A shutter as arrays of the file."""
    arrays = {
        "shutter.times": shutter.times,
        "shutter.intrinsics": shutter.intrinsics,
        "shutter.world_from_camera": shutter.world_from_camera,
    }
    for number, (bones, objects) in enumerate(zip(shutter.world_from_bone, shutter.world_from_object, strict=True)):
        arrays[f"shutter.actor.{number}.world_from_bone"] = bones
        arrays[f"shutter.actor.{number}.world_from_object"] = objects
    return arrays


def read_shutter(arrays: Mapping[str, np.ndarray], actors: int) -> Shutter | None:
    """The shutter in a file's arrays, float64; None where there is none.

    Raises:
        ShotError: an array is missing or of another type.
    """
    if "shutter.times" not in arrays:
        return None

    def of_actors(name: str) -> tuple[np.ndarray, ...]:
        return tuple(_real(arrays, f"shutter.actor.{number}.{name}") for number in range(actors))

    times, intrinsics, cameras = (
        _real(arrays, f"shutter.{name}") for name in ("times", "intrinsics", "world_from_camera")
    )
    return Shutter(times, intrinsics, cameras, of_actors("world_from_bone"), of_actors("world_from_object"))


def lens_arrays(lens: Lens) -> dict[str, np.ndarray]:
    """A lens as arrays of the file."""
    return {f"lens.{name}": np.asarray(getattr(lens, name), dtype=np.float64) for name in LENS_FIELDS}


def read_lens(arrays: Mapping[str, np.ndarray]) -> Lens | None:
    """The lens in a file's arrays, float64; None where there is none.

    Raises:
        ShotError: an array is missing or of another type.
    """
    if "lens.radius" not in arrays:
        return None
    return Lens(*(_real(arrays, f"lens.{name}") for name in LENS_FIELDS))


def read_samples(arrays: Mapping[str, np.ndarray]) -> int | None:
    """How many samples a pixel the shot asks for; None where it does not say.

    Raises:
        ShotError: no whole number from 1 to ``MOST_BLUR_SAMPLES``.
    """
    if "blur.samples" not in arrays:
        return None
    samples = arrays["blur.samples"]
    if samples.shape != () or samples.dtype.kind not in "iu" or not 1 <= samples <= MOST_BLUR_SAMPLES:
        raise ShotError(
            f"blur.samples is {shortened(samples)}, expected one whole number from 1 to {MOST_BLUR_SAMPLES}"
        )
    return int(samples)


def check_shutter(shutter: Shutter, frames: np.ndarray, actors: Sequence[Member]) -> None:
    """``ShotError`` where a shutter's arrays do not fit the shot's frames and actors, or hold what none may."""
    times = shutter.times
    sound = times.ndim == 1 and 1 <= len(times) <= MOST_TIMES and bool((np.abs(times) <= LARGEST).all())
    if not sound or (np.diff(times) < 0).any():
        raise ShotError(f"shutter.times is {shortened(times.tolist())}, expected 1 to {MOST_TIMES} times, increasing")
    size = (len(frames), len(times))
    check_shape("shutter.intrinsics", shutter.intrinsics, (*size, 3, 3))
    check_shape("shutter.world_from_camera", shutter.world_from_camera, (*size, 4, 4))
    moments = np.repeat(frames, len(times))
    check_intrinsics(shutter.intrinsics.reshape(-1, 3, 3), moments)
    check_rigid(shutter.world_from_camera.reshape(-1, 1, 4, 4), moments, ["the camera"])
    for actor, bones, objects in zip(actors, shutter.world_from_bone, shutter.world_from_object, strict=True):
        label = f"of actor '{actor.name}'"
        for kind, names, array in (("bone", actor.bones, bones), ("object", actor.objects, objects)):
            check_shape(f"shutter.world_from_{kind} {label}", array, (*size, len(names), 4, 4))
            words = [f"{kind} '{name}' {label}" for name in names]
            check_rigid(array.reshape(len(moments), len(names), 4, 4), moments, words)


def check_lens(lens: Lens, frames: np.ndarray) -> None:
    """``ShotError`` where a lens does not fit the shot's frames, or focuses on nothing."""
    for name in LENS_FIELDS:
        array = getattr(lens, name)
        check_shape(f"lens.{name}", array, (len(frames),))
        fine = np.abs(array) <= LARGEST
        if not fine.all():
            raise ShotError(f"lens.{name} in frame {frames[~fine][0]} is not finite, or beyond {LARGEST:g}")
    for name in ("radius", "focus_distance", "ratio"):
        array = getattr(lens, name)
        wrong = (array < 0.0) if name == "radius" else (array <= 0.0) & (lens.radius > 0.0)
        if wrong.any():
            raise ShotError(
                f"lens.{name} in frame {frames[wrong][0]} is {array[wrong][0]:g}, expected more than 0; set the "
                "camera's focus and aperture, or switch its depth of field off"
            )


def _real(arrays: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    if name not in arrays:
        raise ShotError(f"the array '{name}' is missing; export the shot again")
    if arrays[name].dtype.kind != "f":
        raise ShotError(f"'{name}' has the type {arrays[name].dtype}, expected float64")
    return arrays[name].astype(np.float64)

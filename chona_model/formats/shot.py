"""The shot: cameras and actors over a frame range, as ``docs/file-formats.md`` describes it.

A shot is checked whole when it is read and before it is written, so that nothing behind it meets a NaN, a sheared bone
or a frame twice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

import msgspec
import numpy as np

from chona_model.camera import ORTHOGRAPHIC, PERSPECTIVE, Camera
from chona_model.data.dataset import Pose
from chona_model.formats.atomic import atomic_path
from chona_model.formats.shot_blur import (
    Lens,
    Shutter,
    check_lens,
    check_shutter,
    lens_arrays,
    read_lens,
    read_samples,
    read_shutter,
    shutter_arrays,
)
from chona_model.formats.shot_checks import LARGEST_DEPTH, ShotError, check_intrinsics, check_rigid, check_shape
from chona_model.plain_arrays import ArraysError, read_arrays
from chona_model.plain_json import JsonError, decode, shortened

FORMAT = "chona-shot"
VERSION = 1
MAX_IMAGE_SIZE = 65536
MAX_PIXELS = 1 << 28
"""Of an image: 16384 x 16384."""
MAX_FRAME = (1 << 31) - 1
LONGEST_NAME = 200
"""Bytes of a shot's name; with number and ending, file systems take 255."""
MAX_SCALE = 1e6
_RESERVED = frozenset('/\\:*?"<>|\0')

__all__ = ["Lens", "Shot", "ShotActor", "ShotError", "Shutter", "read_shot", "write_shot", "write_shot_to"]


class _Kind(msgspec.Struct):
    """What every version of the header has."""

    format: str
    version: int


class _ActorHeader(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    name: str
    person: str | None
    objects: list[str]
    bones: list[str]
    model: str | None = None


class _Header(msgspec.Struct, forbid_unknown_fields=True):
    format: str
    version: int
    name: str
    fps: float
    width: int
    height: int
    camera_kind: Literal["PERSP", "ORTHO"]
    actors: list[_ActorHeader]


@dataclass(frozen=True)
class ShotActor:
    """One actor over the F frames of a shot.

    Attributes:
        name: as the scene calls it, unique in the shot.
        person: identity, or None for objects alone.
        objects: N identities.
        bones: B names in the order of ``world_from_bone``.
        world_from_bone: [F, B, 4, 4] rigid, metres.
        world_from_object: [F, N, 4, 4] rigid, metres.
        model: path of its model's file, which may be relative to the shot's; None for the model that the shot is baked
            with.
    """

    name: str
    person: str | None
    objects: tuple[str, ...]
    bones: tuple[str, ...]
    world_from_bone: np.ndarray
    world_from_object: np.ndarray
    model: str | None = None

    def pose(self, index: int) -> Pose:
        """The actor in the frame at ``index`` (a position in ``Shot.frames``, not a frame number)."""
        return Pose(self.person, self.objects, self.world_from_bone[index], self.world_from_object[index])


@dataclass(frozen=True)
class Shot:
    """Cameras and actors over F frames; checked on construction.

    Attributes:
        name: stem of the baked files' names.
        fps: frames a second.
        width, height: pixels.
        camera_kind: ``PERSP`` or ``ORTHO``.
        frames: [F] int64, increasing, may be negative.
        intrinsics: [F, 3, 3] pixels (``ORTHO``: pixels a metre), pixel centres at +0.5.
        world_from_camera: [F, 4, 4] rigid, OpenCV axes, metres.
        clip: [F, 2] near and far along the camera axis, metres.
        actors: at least one.
        world_scale: metres of the scene in one of the shot's; where the scene's figure is scaled, camera and poses are
            written at the model's own size, and depths are to be multiplied by this.
        shutter: moments that a frame is blurred over; None: it is sharp.
        lens: what is out of focus is blurred by; None: nothing is.
        blur_samples: rays a pixel that the scene asks for where either blurs; None: it does not say.

    Raises:
        ShotError: anything of this does not hold; the message names the array, the actor, the bone and the frame.
    """

    name: str
    fps: float
    width: int
    height: int
    camera_kind: str
    frames: np.ndarray
    intrinsics: np.ndarray
    world_from_camera: np.ndarray
    clip: np.ndarray
    actors: tuple[ShotActor, ...]
    world_scale: float = 1.0
    shutter: Shutter | None = None
    lens: Lens | None = None
    blur_samples: int | None = None

    def __post_init__(self) -> None:
        _check_header(self)
        _check_frames(self.frames)
        _check_cameras(self)
        for actor in self.actors:
            _check_actor(actor, self.frames)
        if self.shutter is not None:
            check_shutter(self.shutter, self.frames, self.actors)
        if self.lens is not None:
            check_lens(self.lens, self.frames)

    def __len__(self) -> int:
        return len(self.frames)

    def camera(self, index: int) -> Camera:
        """The camera of the frame at ``index`` (a position in ``frames``, not a frame number)."""
        return Camera(
            self.intrinsics[index], self.world_from_camera[index], self.width, self.height, kind=self.camera_kind
        )

    def moment(self, index: int, time: int | None) -> tuple[list[Pose], Camera]:
        """Every actor's pose, and the camera, of the frame at ``index``.

        Args:
            time: a position in ``shutter.times``; None: the frame's own time.
        """
        if time is None or self.shutter is None:
            return [actor.pose(index) for actor in self.actors], self.camera(index)
        own, place = self.shutter, (index, time)
        poses = [
            Pose(actor.person, actor.objects, bones[place], objects[place])
            for actor, bones, objects in zip(self.actors, own.world_from_bone, own.world_from_object, strict=True)
        ]
        camera = Camera(
            own.intrinsics[place], own.world_from_camera[place], self.width, self.height, kind=self.camera_kind
        )
        return poses, camera


def write_shot(path: Path, shot: Shot) -> None:
    """Writes a shot whole or not at all.

    Raises:
        OSError: the disk is full or the folder cannot be written to.
    """
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        write_shot_to(file, shot)


def write_shot_to(stream: BinaryIO, shot: Shot) -> None:
    """Writes a shot's bytes to an open stream."""
    header = _Header(
        format=FORMAT,
        version=VERSION,
        name=shot.name,
        fps=shot.fps,
        width=shot.width,
        height=shot.height,
        camera_kind="ORTHO" if shot.camera_kind == ORTHOGRAPHIC else "PERSP",
        actors=[_ActorHeader(a.name, a.person, list(a.objects), list(a.bones), a.model) for a in shot.actors],
    )
    arrays = {
        "header": np.frombuffer(msgspec.json.encode(header), dtype=np.uint8),
        "frames": shot.frames,
        "camera.intrinsics": shot.intrinsics,
        "camera.world_from_camera": shot.world_from_camera,
        "camera.clip": shot.clip,
    }
    if shot.world_scale != 1.0:
        arrays["world_scale"] = np.array(shot.world_scale)
    for index, actor in enumerate(shot.actors):
        arrays[f"actor.{index}.world_from_bone"] = actor.world_from_bone
        arrays[f"actor.{index}.world_from_object"] = actor.world_from_object
    if shot.shutter is not None:
        arrays |= shutter_arrays(shot.shutter)
    if shot.lens is not None:
        arrays |= lens_arrays(shot.lens)
    if shot.blur_samples is not None:
        arrays["blur.samples"] = np.array(shot.blur_samples, dtype=np.int64)
    np.savez(stream, **arrays)  # type: ignore[arg-type]


def read_shot(source: Path | BinaryIO) -> Shot:
    """Reads and checks a shot, from a file or from an open stream.

    Raises:
        ShotError: the file is missing, damaged, of another version, or its contents break the format.
    """
    path = source if isinstance(source, Path) else "a stream"
    try:
        arrays = read_arrays(source)
    except (OSError, ArraysError) as error:
        raise ShotError(
            f"cannot read the shot {path}: {error}; expected a file NAME.shot.npz, export it again"
        ) from error
    header = _header(arrays, path)
    try:
        actors = tuple(
            ShotActor(
                actor.name,
                actor.person,
                tuple(actor.objects),
                tuple(actor.bones),
                _array(arrays, f"actor.{index}.world_from_bone"),
                _array(arrays, f"actor.{index}.world_from_object"),
                actor.model,
            )
            for index, actor in enumerate(header.actors)
        )
        return Shot(
            header.name,
            header.fps,
            header.width,
            header.height,
            header.camera_kind,
            _array(arrays, "frames", "iu"),
            _array(arrays, "camera.intrinsics"),
            _array(arrays, "camera.world_from_camera"),
            _array(arrays, "camera.clip"),
            actors,
            _scale(arrays),
            read_shutter(arrays, len(actors)),
            read_lens(arrays),
            read_samples(arrays),
        )
    except ShotError as error:
        raise ShotError(f"{path}: {error}") from error


def _header(arrays: Mapping[str, np.ndarray], path: Path | str) -> _Header:
    if "header" not in arrays or arrays["header"].dtype != np.uint8:
        raise ShotError(f"{path} has no header (uint8, JSON); expected a shot written by the add-on, export it again")
    text = arrays["header"].tobytes()
    try:
        kind = decode(text, _Kind)
        if kind.format != FORMAT:
            raise ShotError(f"{path} is a '{shortened(kind.format)}', expected a '{FORMAT}'")
        if kind.version != VERSION:
            raise ShotError(
                f"{path} is a shot of version {kind.version}, this program reads version {VERSION}; export it again "
                "with the add-on that came with this program"
            )
        return decode(text, _Header)
    except JsonError as error:
        raise ShotError(f"the header of {path} breaks the format: {error}; export the shot again") from error


def _array(arrays: Mapping[str, np.ndarray], name: str, kinds: str = "f") -> np.ndarray:
    if name not in arrays:
        raise ShotError(f"the array '{name}' is missing; export the shot again")
    array = arrays[name]
    if array.dtype.kind not in kinds:
        raise ShotError(f"'{name}' has the type {array.dtype}, expected {'float64' if kinds == 'f' else 'int64'}")
    return array.astype(np.float64 if kinds == "f" else np.int64)


def _scale(arrays: Mapping[str, np.ndarray]) -> float:
    if "world_scale" not in arrays:
        return 1.0
    scale = _array(arrays, "world_scale")
    if scale.shape != () or not 1.0 / MAX_SCALE <= scale <= MAX_SCALE:
        raise ShotError(
            f"world_scale is {shortened(scale)}, expected one positive number up to {MAX_SCALE:g}: write the shot again"
        )
    return float(scale)


def _check_header(shot: Shot) -> None:
    odd = _RESERVED & set(shot.name) or any(ord(letter) < 32 for letter in shot.name)
    if not shot.name or shot.name.strip() != shot.name or odd or shot.name.startswith("."):
        raise ShotError(
            f"the shot is called {shot.name[:LONGEST_NAME]!r}, expected a name that can be part of a file name"
        )
    if len(shot.name.encode()) > LONGEST_NAME:
        raise ShotError(f"the shot's name has {len(shot.name.encode())} bytes, expected at most {LONGEST_NAME}")
    if not (np.isfinite(shot.fps) and shot.fps > 0):
        raise ShotError(f"fps is {shot.fps}, expected a positive number")
    if not (1 <= shot.width <= MAX_IMAGE_SIZE and 1 <= shot.height <= MAX_IMAGE_SIZE):
        raise ShotError(f"the image has {shot.width}x{shot.height} pixels, expected 1 to {MAX_IMAGE_SIZE} each way")
    if shot.width * shot.height > MAX_PIXELS:
        raise ShotError(f"the image has {shot.width}x{shot.height} pixels, expected at most {MAX_PIXELS} in all")
    if shot.camera_kind not in (PERSPECTIVE, ORTHOGRAPHIC):
        raise ShotError(f"camera_kind is '{shot.camera_kind}', expected {PERSPECTIVE} or {ORTHOGRAPHIC}")
    if not shot.actors:
        raise ShotError("the shot has no actor; map a rig or an object to the model before exporting")
    names = [actor.name for actor in shot.actors]
    doubled = sorted(name for name, count in Counter(names).items() if count > 1)
    if doubled:
        raise ShotError(f"two actors are called '{doubled[0]}'; give each its own name")


def _check_frames(frames: np.ndarray) -> None:
    if frames.ndim != 1 or frames.dtype.kind not in "iu":
        raise ShotError(f"frames has the shape {frames.shape} and type {frames.dtype}, expected [F] int64")
    if not len(frames):
        raise ShotError("the frame range is empty; expected at least one frame, check the scene's start and end")
    if (np.abs(frames.astype(np.float64)) > MAX_FRAME).any():
        raise ShotError(f"frames are {frames.min()} to {frames.max()}, expected numbers up to {MAX_FRAME} either way")
    back = np.flatnonzero(np.diff(frames) <= 0)
    if len(back):
        before, after = frames[back[0]], frames[back[0] + 1]
        raise ShotError(f"frames must increase, but {after} follows {before}; export each frame once, in order")


def _check_cameras(shot: Shot) -> None:
    count = len(shot.frames)
    check_shape("camera.intrinsics", shot.intrinsics, (count, 3, 3))
    check_shape("camera.world_from_camera", shot.world_from_camera, (count, 4, 4))
    check_shape("camera.clip", shot.clip, (count, 2))
    check_rigid(shot.world_from_camera[:, None], shot.frames, ["the camera"])
    check_intrinsics(shot.intrinsics, shot.frames)
    for (near, far), frame in zip(shot.clip, shot.frames, strict=True):
        if not -LARGEST_DEPTH <= near < far <= LARGEST_DEPTH or (near < 0 and shot.camera_kind == PERSPECTIVE):
            raise ShotError(
                f"the camera's clip range in frame {frame} is {near} to {far}, expected 0 <= near < far <= "
                f"{LARGEST_DEPTH:.3g}; correct Clip Start and End of the camera"
            )


def _check_actor(actor: ShotActor, frames: np.ndarray) -> None:
    if not actor.bones and not actor.objects:
        raise ShotError(f"actor '{actor.name}' has neither bones nor objects; map at least one")
    if actor.person is not None and not actor.bones:
        raise ShotError(f"actor '{actor.name}' is the person '{actor.person}' but has no bones; map its rig")
    if len(set(actor.bones)) != len(actor.bones):
        raise ShotError(f"actor '{actor.name}' has a bone name twice; bone names must be unique")
    label = f"of actor '{actor.name}'"
    check_shape(f"world_from_bone {label}", actor.world_from_bone, (len(frames), len(actor.bones), 4, 4))
    check_shape(f"world_from_object {label}", actor.world_from_object, (len(frames), len(actor.objects), 4, 4))
    check_rigid(actor.world_from_bone, frames, [f"bone '{bone}' {label}" for bone in actor.bones])
    check_rigid(actor.world_from_object, frames, [f"object '{name}' {label}" for name in actor.objects])

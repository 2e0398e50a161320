"""What bakes will take: the last estimate of every scene, and what has changed since. Kept while Blender runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import bpy

from . import model_cache, preferences
from .bake_frames import frame_bounds
from .events import need
from .jobs import duration

NOT_KNOWN = "–"


class Facts(NamedTuple):
    """What an estimate depends on. Reading it opens no file and evaluates nothing: panels do it."""

    model: tuple[object, ...]
    actors: tuple[object, ...]
    frames: tuple[int, int, int]
    size: tuple[float, ...]
    camera: tuple[object, ...]
    blur: tuple[object, ...]
    device: str


CHANGED = Facts(
    "the model", "the actors", "the frame range", "the size of the picture", "the camera", "the blur", "the device"
)
"""Every fact in words."""


@dataclass(frozen=True)
class Cost:
    """Of a preset, on this computer: seconds of a frame, and of the whole bake with its start."""

    seconds: float
    total: float


@dataclass(frozen=True)
class Estimate:
    """What `chona estimate` said of a bake: its facts, how many frames it has, and every preset's cost by name."""

    facts: Facts
    frames: int
    presets: dict[str, Cost]


_kept: dict[int, Estimate] = {}


def keep(scene: bpy.types.Scene, facts: Facts, result: dict[str, Any]) -> Estimate:
    """Remember what the worker has said of a scene's bake.

    Raises:
        ChonaError: it has said something else.
    """
    need(result, "presets", "frames")
    costs = {name: Cost(each["seconds_per_frame"], each["total_seconds"]) for name, each in result["presets"].items()}
    estimate = Estimate(facts, result["frames"], costs)
    _kept[scene.session_uid] = estimate
    return estimate


def last(scene: bpy.types.Scene) -> Estimate | None:
    """The scene's last estimate."""
    return _kept.get(scene.session_uid)


def forget() -> None:
    """Drop everything: the add-on is switched off."""
    _kept.clear()


def changes(estimate: Estimate, now: Facts) -> str:
    """What is not as it was when the bake was estimated, in words; nothing where the estimate holds."""
    pairs = zip(estimate.facts, now, CHANGED, strict=True)
    return " and ".join(words for before, after, words in pairs if before != after)


def facts_of(scene: bpy.types.Scene) -> Facts:
    """What an estimate would depend on now."""
    settings, render = scene.chona, scene.render
    actors = settings.used_actors()
    paths = dict.fromkeys(actor.model_path for actor in actors)
    return Facts(
        tuple((bpy.path.abspath(path), model_cache.stamp(path)) for path in paths),
        tuple((actor.model_path, actor.person, _name(actor.armature), _objects(actor)) for actor in actors),
        frame_bounds(scene),
        (render.resolution_x, render.resolution_y, render.resolution_percentage,
         render.pixel_aspect_x, render.pixel_aspect_y),
        _camera(scene.camera),
        _blur(scene),
        preferences.device(),
    )  # fmt: skip


def _objects(actor: Any) -> tuple[tuple[str, str], ...]:
    return tuple((item.name, _name(item.empty)) for item in actor.used_objects())


def _name(item: bpy.types.Object | None) -> str:
    return "" if item is None else item.name


def _blur(scene: bpy.types.Scene) -> tuple[object, ...]:
    own, camera = scene.chona.blur, scene.camera
    motion = own.use_motion_blur and scene.render.use_motion_blur
    focus = own.use_depth_of_field and camera is not None and camera.type == "CAMERA" and camera.data.dof.use_dof
    return motion, focus, own.samples if motion or focus else 0


def _camera(camera: bpy.types.Object | None) -> tuple[object, ...]:
    """Which camera, and where it stands and how it looks unless that changes by itself from frame to frame."""
    if camera is None or camera.type != "CAMERA":
        return ()
    facts: list[object] = [camera.name, camera.data.name]
    if camera.animation_data is None and camera.parent is None and not camera.constraints:
        facts += [value for row in camera.matrix_basis for value in row]
    if camera.data.animation_data is None:
        lens = camera.data
        facts += [lens.type, lens.lens, lens.ortho_scale, lens.sensor_width, lens.sensor_height, lens.sensor_fit]
        facts += [lens.shift_x, lens.shift_y]
    return tuple(facts)


def time_words(seconds: float) -> str:
    """As one says it: `4 ms`, `0.04 s`, `0.8 s`, `12 s`, `3 min 20 s`, `19 min`, `1 h 05 min`."""
    if seconds < 0.0095:
        return f"{1e3 * seconds:.0f} ms"
    if seconds < 0.0995:
        return f"{seconds:.2f} s"
    if 570.0 <= seconds < 3570.0:  # nobody plans by the seconds of so many minutes
        return f"{round(seconds / 60.0)} min"
    return f"{seconds:.1f} s" if seconds < 9.95 else duration(seconds)


def frame_words(seconds: float) -> str:
    """Of a frame, in a narrow column: as `time_words`, in seconds up to ten minutes."""
    return f"{round(seconds)} s" if 9.95 <= seconds < 599.5 else time_words(seconds)


def quality_words(figures: dict[str, Any] | None) -> str:
    """`31.2 dB` of a preset's figures in a model's trade."""
    psnr = None if figures is None else figures.get("psnr")
    return NOT_KNOWN if psnr is None else f"{psnr:.1f} dB"


def sentence(name: str, trade: dict[str, Any] | None, estimate: Estimate) -> str:
    """`final: 31.2 dB, 0.8 s a frame here; 250 frames ≈ 3 min 20 s`."""
    cost, figures = estimate.presets[name], None if trade is None else trade["presets"].get(name)
    quality = "" if quality_words(figures) == NOT_KNOWN else f"{quality_words(figures)}, "
    frames = f"{estimate.frames} frame{'s' * (estimate.frames != 1)}"
    return f"{name}: {quality}{time_words(cost.seconds)} a frame here; {frames} ≈ {time_words(cost.total)}"

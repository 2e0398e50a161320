"""Baking a shot: every frame rendered and written as EXR; finished frames are left alone."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from chona_model.actor import EMPTY_DEPTH, Actor, Picture
from chona_model.camera import Camera
from chona_model.formats.exr import FrameHeader, FrameLayers, frame_name, is_finished, read_frame, write_frame
from chona_model.formats.model_file import file_hash
from chona_model.formats.shot import Shot, ShotError, read_shot
from chona_model.model_store import load_actor
from chona_model.progress import Progress
from chona_model.settings import RENDER_PRESETS, RenderSettings


@dataclass(frozen=True)
class BakeReport:
    """What a bake did: frames written and skipped, those of the written that repeat an earlier one, and seconds."""

    written: int
    skipped: int
    repeated: int
    seconds: float


def bake(
    model: Path, shot: Path, out: Path, frames: Sequence[int] | None, preset: str, overwrite: bool, progress: Progress,
    device: str = "cpu",
) -> BakeReport:  # fmt: skip
    """Renders a shot's frames to ``OUT/NAME_0001.exr`` ….

    A frame that is already there, whole, and of the same model, pose, camera and settings is skipped unless
    ``overwrite``.  A frame that shows what an earlier one of this run shows is copied from it (holds, cycles).  When
    cancelled, every frame on disk is a finished one.

    Args:
        frames: frame numbers to bake; None for all of the shot.

    Raises:
        ShotError: the shot is damaged, or a frame, person, object or bone in it is unknown.
        ModelFileError: the model cannot be loaded.  OSError: the folder cannot be written to.
    """
    content = read_shot(shot)
    chosen = choose_frames(content, frames)
    actor = load_actor(model, device)
    check_actors(content, actor)
    settings, digest = RENDER_PRESETS[preset], file_hash(model)
    _check_writable(out)
    began = time.perf_counter()
    written = skipped = repeated = 0
    rendered: dict[str, Path] = {}
    progress.start("bake", len(chosen), unit="frame")
    for index in chosen:
        if progress.cancelled_by_user:
            break
        path = out / frame_name(content.name, int(content.frames[index]))
        key = frame_hash(content, index, settings)
        if not overwrite and is_finished(path, digest, key):
            skipped += 1
        else:
            start = time.perf_counter()
            if key in rendered and rendered[key].is_file():
                layers, _ = read_frame(rendered[key])
                repeated += 1
            else:
                layers = render_frame(actor, content, index, settings)
                rendered[key] = path
            seconds = time.perf_counter() - start
            header = FrameHeader(digest, key, preset, json.dumps(asdict(settings)), seconds, int(content.frames[index]))
            write_frame(path, layers, header)
            written += 1
        progress.update(written + skipped, path.name)
    report = BakeReport(written, skipped, repeated, time.perf_counter() - began)
    finish = progress.cancelled if progress.cancelled_by_user else progress.result
    finish(written=written, skipped=skipped, repeated=repeated, seconds=round(report.seconds, 3), out=str(out))
    return report


def render_frame(
    actor: Actor, shot: Shot, index: int, settings: RenderSettings, camera: Camera | None = None
) -> FrameLayers:
    """One frame's pixels, seen by the shot's camera or another: actors are layered by depth, pixel by pixel."""
    camera = camera or shot.camera(index)
    pictures = [actor.render(member.pose(index), camera, settings) for member in shot.actors]
    near, far = shot.clip[index]
    layers = [_layer(picture, near, far) for picture in pictures]
    merged = layers[0]
    for other in layers[1:]:
        merged = _merge(merged, other)
    combined, depth, human, thing, confidence = merged
    scaled = np.where(depth < EMPTY_DEPTH, depth * np.float32(shot.world_scale), np.float32(EMPTY_DEPTH))
    return FrameLayers(combined, scaled, human, thing, confidence)


Layer = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _layer(picture: Picture, near: float, far: float) -> Layer:
    """Scene-linear, premultiplied; empty where the surface lies outside the clip range, as Blender's camera cuts."""
    alpha = picture.alpha[..., None]
    straight = np.divide(picture.rgb, alpha, out=np.zeros_like(picture.rgb), where=alpha > 0)
    kept = (picture.depth >= near) & (picture.depth <= far)
    combined = np.concatenate([linear_from_srgb(np.clip(straight, 0.0, 1.0)) * alpha, alpha], axis=-1)
    return (
        np.where(kept[..., None], combined, np.float32(0.0)), np.where(kept, picture.depth, np.float32(EMPTY_DEPTH)),
        picture.human * kept, picture.object * kept, picture.confidence,
    )  # fmt: skip


def _merge(one: Layer, other: Layer) -> Layer:
    nearer = one[1] <= other[1]
    front = [np.where(nearer if a.ndim == 2 else nearer[..., None], a, b) for a, b in zip(one, other, strict=True)]
    back = [np.where(nearer if a.ndim == 2 else nearer[..., None], b, a) for a, b in zip(one, other, strict=True)]
    through = 1.0 - front[0][..., 3]
    return (
        front[0] + through[..., None] * back[0], front[1], front[2] + through * back[2], front[3] + through * back[3],
        np.minimum(front[4], back[4]),
    )  # fmt: skip


def linear_from_srgb(colour: np.ndarray) -> np.ndarray:
    """The sRGB transfer curve (IEC 61966-2-1) undone; 0…1 to 0…1, float32."""
    low, high = colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4
    return np.where(colour <= 0.04045, low, high).astype(np.float32)


def frame_hash(shot: Shot, index: int, settings: RenderSettings) -> str:
    """SHA-256 over everything a frame's pixels depend on besides the model."""
    digest = hashlib.sha256()
    facts = {
        "size": [shot.width, shot.height], "kind": shot.camera_kind, "scale": shot.world_scale,
        "settings": asdict(settings),
        "actors": [[actor.person, list(actor.objects), list(actor.bones)] for actor in shot.actors],
    }  # fmt: skip
    digest.update(json.dumps(facts, sort_keys=True).encode())
    arrays = [shot.intrinsics, shot.world_from_camera, shot.clip]
    for actor in shot.actors:
        arrays += [actor.world_from_bone, actor.world_from_object]
    for array in arrays:
        digest.update(np.ascontiguousarray(array[index], dtype=np.float64).tobytes())
    return digest.hexdigest()


def choose_frames(shot: Shot, frames: Sequence[int] | None) -> list[int]:
    """Places in the shot of the frames asked for; ``ShotError`` where one is not in it. None: all."""
    if frames is None:
        return list(range(len(shot)))
    place = {int(frame): index for index, frame in enumerate(shot.frames)}
    missing = sorted(set(frames) - set(place))
    if missing or not frames:
        raise ShotError(
            f"frame {missing[0] if missing else '(none)'} is not in the shot; it has {min(place)} to {max(place)} "
            f"({len(place)} frames): choose among them with --frames, or write the shot again"
        )
    return [place[frame] for frame in sorted(set(frames))]


def check_actors(shot: Shot, actor: Actor) -> None:
    """``ShotError`` where the shot wants a person, an object or a bone that the model lacks."""
    for member in shot.actors:
        if member.person is not None and member.person not in actor.persons:
            raise ShotError(
                f"actor '{member.name}' wants the person '{member.person}', the model has {', '.join(actor.persons)}"
            )
        for name in member.objects:
            if name not in actor.objects:
                raise ShotError(f"actor '{member.name}' wants the object '{name}', the model has "
                                f"{', '.join(actor.objects) or 'none'}")  # fmt: skip
        if member.person is not None and member.bones != actor.skeleton.names:
            missing = [name for name in actor.skeleton.names if name not in member.bones]
            raise ShotError(
                f"actor '{member.name}' lacks the model's bone '{missing[0]}': map it in the rig"
                if missing
                else f"actor '{member.name}' has its bones in another order than the model; write the shot again"
            )


def _check_writable(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".chona-write-test"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OSError(
            f"cannot write to the output folder {out} ({error.strerror}); choose another with --out"
        ) from error

"""Baking a shot: every frame rendered and written as EXR; finished frames are left alone."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from chona_model import memory
from chona_model.adaptive import Reached
from chona_model.bake_report import BakeReport, LeftOut, Tally
from chona_model.blur import AS_IN_THE_SHOT, SHARP, Blur, BlurChoice, blur_of_frame
from chona_model.claims import Claims, each_once
from chona_model.formats.atomic import WriteError
from chona_model.formats.exr import FrameHeader, FrameLayers, frame_name, is_finished, read_frame, write_frame
from chona_model.formats.exr_structure import is_whole
from chona_model.formats.folder_lock import lock_folder
from chona_model.formats.model_file import ModelFileError
from chona_model.formats.shot import Shot, ShotError, read_shot
from chona_model.formats.shot_blur import lens_arrays, shutter_arrays
from chona_model.frame import ShotRenderer, matte_names
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.picture_memory import tile_within
from chona_model.presets import find_preset
from chona_model.progress import Progress
from chona_model.settings import RenderSettings
from chona_model.shot_models import LoadedModels, ShotModels, find_models
from chona_model.sight import bones_at_rest, out_of_picture


class BakeError(OSError):
    """A bake that cannot go on: why, what to do, and what is there."""


def bake(
    model: Path, shot: Path, out: Path, frames: Sequence[int] | None, preset: str, overwrite: bool, progress: Progress,
    device: str = "cpu", passes: Passes = DEFAULT_PASSES, max_error: float = 0.0,
    blur: BlurChoice = AS_IN_THE_SHOT, only_missing: bool = False, share: float = 0.0, max_memory: float | None = None,
) -> BakeReport:  # fmt: skip
    """Renders a shot's frames to ``OUT/NAME_0001.exr`` ….

    A frame that is already there, whole, and of the same model, pose, camera, settings and passes is skipped unless
    ``overwrite``.  A frame that shows what another of the shot shows is copied from it (holds, cycles), whether this
    run or an earlier one rendered it.  Of a model only the identities that its actors show are loaded, and only when a
    frame has to be rendered.  When cancelled, every frame on disk is a finished one.

    Args:
        model: of the actors that name none in the shot.
        frames: frame numbers to bake; None for all of the shot.
        preset: a name, or the path of a preset's file.
        passes: what frames have besides their colours.
        max_error: bound on colour and alpha, see ``adaptive.render_within``; 0 for none.
        blur: motion blur and depth of field.
        only_missing: leave every frame alone that is there and whole, of whatever model, pose and settings.
        share: others may bake into the same folder at the same time, and no frame is rendered twice; a frame whose
            process gave no sign of life for so many seconds is taken over.  0: nobody else does.
        max_memory: of the whole process, GB of 2^30 bytes; None for what there is.

    Raises:
        SettingsError: there is no such preset, or ``max_memory`` is less than the pictures take.
        ShotError: the shot is damaged, a frame, model, person, object or bone in it is unknown, or a blur is asked for
            that it has not, or that comes with a bound.
        ModelFileError: a model cannot be loaded, or was replaced before it was read.  FolderBusyError: another process
            bakes some of these frames into the folder.  FolderLostError: the folder was removed meanwhile.
        WriteError, BakeError: it cannot be written to.
    """
    content = read_shot(shot)
    models = find_models(content, model, shot.parent)
    chosen = choose_frames(content, frames)
    settings, digest, blurred = find_preset(preset), models.digest(), blur.of(content)
    if max_error and blurred != SHARP:
        raise ShotError(
            f"--max-error is {max_error:g}, but it bounds sharp frames and the shot '{content.name}' is blurred; raise "
            "--blur-samples instead, or use --motion-blur off and --depth-of-field off"
        )
    began = time.perf_counter()
    done = FinishedFrames(content, settings, out, digest, passes, not overwrite, max_error, blurred)
    tally = Tally(passes)
    source = _Source(models, digest, content, settings, passes, device, max_error, blurred, max_memory)
    written = skipped = repeated = 0

    def is_there(index: int) -> bool:
        return (only_missing and is_whole(done.path(index))) or done.is_finished(index)

    def make(index: int, confirm: Callable[[], None]) -> None:
        nonlocal repeated
        twin = done.twin(index)
        if twin is None:
            source.load()
        start = time.perf_counter()
        layers = read_frame(twin)[0] if twin is not None else source.render(index)
        seconds, number = time.perf_counter() - start, int(content.frames[index])
        more = ({"max_error": max_error} if max_error else {}) | _facts(blur_of_frame(content, index, blurred))
        settled = json.dumps(asdict(settings) | more)
        header = FrameHeader(digest, done.keys[index], settings.preset, settled, seconds, number)
        held.check()
        try:
            write_frame(done.path(index), layers, header, confirm)
        except WriteError as error:
            raise BakeError(f"{error}; {_kept(written + skipped, len(chosen))}") from error
        done.add(index)
        _check_memory(max_memory, done.path(index))
        if twin is not None:
            repeated += 1
        else:
            headers = models.of_actors
            # What is out of the picture at the frame's own time may be in it at another.
            unseen = [] if blurred.motion else out_of_picture(content, index, headers)
            tally.rendered(unseen, bones_at_rest(content, index, headers))

    def name_and_key(index: int) -> tuple[str, str]:
        key = "" if only_missing else f"{digest} {done.keys[index]} {','.join(passes.names)}"
        return done.path(index).stem, key

    def stopped() -> bool:
        return progress.cancelled_by_user

    def waits(left: int) -> None:
        progress.update(written + skipped, f"{left} held by other bakes")

    numbers = [int(content.frames[index]) for index in chosen]
    with (
        lock_folder(out, f"the shot {content.name}", numbers, shared=share > 0) as held,
        Claims(out, share) if share else nullcontext() as claims,
    ):
        progress.start("bake", len(chosen), unit="frame")
        for index, made in each_once(chosen, is_there, make, stopped, claims, name_and_key, waits):
            written, skipped = written + made, skipped + (not made)
            # At once: when this process is killed, its parent says how many frames are there.
            progress.update(written + skipped, done.path(index).name, at_once=made)
    report = BakeReport(
        written, skipped, repeated, time.perf_counter() - began, source.left_out(tally), source.reached,
        models.replaced(digest),
    )  # fmt: skip
    finish = progress.cancelled if progress.cancelled_by_user else progress.result
    finish(**report.as_dict(), out=str(out))
    return report


def _check_memory(allowed: float | None, path: Path) -> None:
    took = memory.highest() or 0
    if allowed is not None and took > allowed * memory.GIGABYTE:
        raise BakeError(
            f"--max-memory is {allowed:g} GB, and {path.name} took {took / memory.GIGABYTE:.2f}; it is kept, and no "
            "other frame was begun: allow more, or bake a smaller picture, fewer samples or fewer passes"
        )


def _kept(there: int, wanted: int) -> str:
    frames = f"{there} frame{'s are' if there != 1 else ' is'} there and whole" if there else "no frame is there yet"
    return f"{frames}, of {wanted}; the same command goes on with the rest"


class FinishedFrames:
    """Which frames of a shot are on disk and up to date, and which of them show the same.

    Attributes:
        keys: ``frame_hash`` of every frame of the shot.

    Args:
        trust: whether frames of earlier runs count.
    """

    def __init__(
        self, shot: Shot, settings: RenderSettings, out: Path, model_hash: str, passes: Passes, trust: bool,
        max_error: float, blur: Blur,
    ) -> None:  # fmt: skip
        self._shot, self._out, self._model, self._passes, self._trust = shot, out, model_hash, passes, trust
        self.keys = [frame_hash(shot, index, settings, max_error, blur) for index in range(len(shot))]
        self._alike: dict[str, list[int]] = {}
        for index, key in enumerate(self.keys):
            self._alike.setdefault(key, []).append(index)
        self._own: set[int] = set()

    def path(self, index: int) -> Path:
        """The file of the frame at ``index``."""
        return self._out / frame_name(self._shot.name, int(self._shot.frames[index]))

    def add(self, index: int) -> None:
        """This run has written the frame."""
        self._own.add(index)

    def is_finished(self, index: int) -> bool:
        """Whether the file is there, whole, and what it should be."""
        trusted = self._trust or index in self._own
        return trusted and is_finished(
            self.path(index), self._model, self.keys[index], self._passes, matte_names(self._shot)
        )

    def twin(self, index: int) -> Path | None:
        """The file of a finished frame that shows the same; looked for only among frames of the same key."""
        alike = (other for other in self._alike[self.keys[index]] if other != index)
        return next((self.path(other) for other in alike if self.is_finished(other)), None)


class _Source:
    """Renders frames, and loads what it takes when the first is asked for."""

    def __init__(
        self, models: ShotModels, digest: str, shot: Shot, settings: RenderSettings, passes: Passes, device: str,
        max_error: float, blur: Blur, max_memory: float | None,
    ) -> None:  # fmt: skip
        self._models, self._digest, self._shot, self._device, self._blur = models, digest, shot, device, blur
        self._max_memory = max_memory
        self._settings, self._passes, self._max_error = settings, passes, max_error
        self._renderer: ShotRenderer | None = None
        self._loaded: LoadedModels | None = None

    def load(self) -> ShotRenderer:
        """Loads what the shot shows, if that is not done."""
        if self._renderer is None:
            self._loaded = self._models.load(self._shot, self._device)
            if self._models.replaced(self._digest):
                raise ModelFileError(
                    f"{', '.join(map(str, self._models.headers))} was replaced before this bake had read it; no frame "
                    "is of the new model yet: bake again"
                )
            actors, tile = self._loaded.actors, None
            if self._max_memory is not None:
                tile = tile_within(self._max_memory, self._shot, self._passes, self._blur != SHARP)
            self._renderer = ShotRenderer(
                actors, self._shot, self._settings, self._passes, self._max_error, self._blur, tile
            )
        return self._renderer

    def render(self, index: int) -> FrameLayers:
        """The pixels of the frame at ``index``."""
        return self.load().render(index)

    @property
    def reached(self) -> Reached | None:
        """What a bound on the error came to; None without one, or where nothing was rendered."""
        return self._renderer.reached if self._renderer else None

    def left_out(self, tally: Tally) -> LeftOut:
        """What was not needed."""
        if self._renderer is None or self._loaded is None:
            return tally.left_out(False, self._models.identities, self._models.size_bytes, 0)
        return tally.left_out(True, self._loaded.left, self._loaded.bytes_left, self._renderer.kept)


def _facts(blur: Blur) -> dict[str, Any]:
    return {} if blur == SHARP else {"blur": asdict(blur)}


def frame_hash(shot: Shot, index: int, settings: RenderSettings, max_error: float = 0.0, blur: Blur = SHARP) -> str:
    """SHA-256 over everything a frame's pixels depend on besides the models."""
    digest, blur = hashlib.sha256(), blur_of_frame(shot, index, blur)
    facts = {
        "size": [shot.width, shot.height], "kind": shot.camera_kind, "scale": shot.world_scale,
        "settings": asdict(settings), **({"max_error": max_error} if max_error else {}),
        **_facts(blur), "actors": [[actor.person, list(actor.objects), list(actor.bones)] for actor in shot.actors],
    }  # fmt: skip
    digest.update(json.dumps(facts, sort_keys=True).encode())
    arrays = [shot.intrinsics, shot.world_from_camera, shot.clip]
    for actor in shot.actors:
        arrays += [actor.world_from_bone, actor.world_from_object]
    if blur.motion and shot.shutter is not None:
        digest.update(shot.shutter.times.tobytes())
        arrays += [array for name, array in shutter_arrays(shot.shutter).items() if name != "shutter.times"]
    if blur.focus and shot.lens is not None:
        arrays += list(lens_arrays(shot.lens).values())
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

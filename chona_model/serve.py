"""A worker that stays up: it keeps a model loaded and renders the poses it is handed, the newest first of all.

Its parent writes requests to its standard input and reads frames from its standard output (docs/file-formats.md).
Nothing else is listened to; when the parent closes its end, or dies, the worker ends.
"""

from __future__ import annotations

import io
import json
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import msgspec
import numpy as np

from chona_model.actor import Actor
from chona_model.camera import Camera, CameraError
from chona_model.data.dataset import Pose
from chona_model.figure import PoseError
from chona_model.formats.model_file import ModelFileError
from chona_model.formats.shot import Shot, ShotError, read_shot
from chona_model.frame import ShotRenderer
from chona_model.model_store import load_actor
from chona_model.passes import Passes
from chona_model.plain_json import JsonError, decode, shortened
from chona_model.settings import RENDER_PRESETS
from chona_model.shot_models import find_models
from chona_model.skeleton import translation

LONGEST_LINE = 1 << 16
LARGEST_SHOT = 1 << 26
"""Bytes of a request's line and of its shot: more is no request of the add-on's."""

WARM_PRESET = "draft"
"""All presets go through the same kernels."""

KEPT_MODELS = 4
"""Models that shots name and that stay loaded, besides the one that is served."""


class RequestError(ValueError):
    """Input that is no request: what follows in the stream cannot be understood either."""


class _Line(msgspec.Struct):
    """What a request begins with."""

    request: int
    preset: str
    bytes: int
    scale: float = 1.0


REFUSED = (ShotError, ModelFileError, PoseError, CameraError, KeyError, RequestError, MemoryError, OSError)
"""What a request can be answered with; anything else is a fault of this program."""


@dataclass(frozen=True)
class Request:
    """One picture that is wanted.

    Attributes:
        number: chosen by the parent, returned with the picture.
        preset: of ``RENDER_PRESETS``; scale: share of the shot's resolution, 0…1.
        shot: the bytes of a shot file, whose first frame is rendered.
    """

    number: int
    preset: str
    scale: float
    shot: bytes


def read_request(stream: BinaryIO) -> Request | None:
    """The next request; None at the end of the stream.

    Raises:
        RequestError: what is there is not a request, or stops in the middle of one.
    """
    line = stream.readline(LONGEST_LINE)
    if not line:
        return None
    try:
        asked = decode(line, _Line)
    except JsonError as error:
        raise RequestError(
            f"a request begins with {line[:80]!r} ({error}), expected one line of JSON with request, preset and bytes"
        ) from error
    number, size = asked.request, asked.bytes
    if not 0 < size <= LARGEST_SHOT:
        raise RequestError(f"request {number} announces {size} bytes, expected 1 to {LARGEST_SHOT}")
    shot = stream.read(size)
    if len(shot) < size:
        raise RequestError(f"request {number} announces {size} bytes and ends after {len(shot)}")
    return Request(number, asked.preset, asked.scale, shot)


class Inbox:
    """The newest request; those it overtakes are remembered by their numbers.  Filled by a thread of its own."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._changed = stream, threading.Condition()
        self._newest: Request | None = None
        self._overtaken: list[int] = []
        self._ended = False
        self._error: RequestError | OSError | None = None
        threading.Thread(target=self._fill, daemon=True).start()

    def _fill(self) -> None:
        error: RequestError | OSError | None = None
        try:
            while (request := read_request(self._stream)) is not None:
                with self._changed:
                    if self._newest is not None:
                        self._overtaken.append(self._newest.number)
                    self._newest = request
                    self._changed.notify()
        except (RequestError, OSError) as problem:
            error = problem
        finally:  # whatever happens here, nobody may wait for ever
            with self._changed:
                self._ended, self._error = True, error
                self._changed.notify()

    def next(self) -> tuple[Request | None, list[int]]:
        """Waits for a request; None at the end.  Also the numbers of those that came to nothing since the last call.

        Raises:
            RequestError: the stream holds something else.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._ended)
            request, self._newest = self._newest, None
            overtaken, self._overtaken = self._overtaken, []
            if request is None and self._error is not None:
                raise self._error
            return request, overtaken


def serve(model: Path, device: str, source: BinaryIO, out: BinaryIO) -> None:
    """Loads a model, says that it is ready and answers requests until the parent closes its end.

    A request that cannot be rendered is answered with an error, and the next one is waited for.  Models that a shot's
    actors name are loaded when they are first wanted, and again when their files change.

    Raises:
        ModelFileError: the model cannot be loaded.  RequestError: the input is not the protocol's.
    """
    began = time.perf_counter()
    inbox = Inbox(source)
    models = _Models(model, device)
    _warm(models.served)
    _say(out, {"event": "ready", "job": "serve", "seconds": round(time.perf_counter() - began, 3)})
    while True:
        request, overtaken = inbox.next()
        for number in overtaken:
            _say(out, {"event": "skipped", "request": number})
        if request is None:
            return
        try:
            _answer(out, models, request)
        except BrokenPipeError:
            raise
        except REFUSED as error:
            _say(out, {"event": "error", "request": request.number, "message": shortened(error)})


class _Models:
    """Loaded models, with everybody in them: which of them the next pose shows nobody knows.

    Attributes:
        served: the one for actors that name none.
    """

    def __init__(self, served: Path, device: str) -> None:
        self._path, self._device = served, device
        self.served = load_actor(served, device)
        self._named: dict[tuple[Path, int, int], Actor] = {}

    def of(self, shot: Shot) -> list[Actor]:
        """What renders each of a shot's actors."""
        return [self._loaded(path) for path in find_models(shot, self._path, None).paths]

    def _loaded(self, path: Path) -> Actor:
        if path == self._path:
            return self.served
        state = path.stat()
        key = (path.resolve(), state.st_mtime_ns, state.st_size)
        actor = self._named.pop(key, None) or load_actor(path, self._device)
        for old in [known for known in self._named if known[0] == key[0]]:  # its file has changed
            del self._named[old]
        while len(self._named) >= KEPT_MODELS:
            del self._named[next(iter(self._named))]
        self._named[key] = actor
        return actor


def _answer(out: BinaryIO, models: _Models, request: Request) -> None:
    began = time.perf_counter()
    if request.preset not in RENDER_PRESETS:
        raise RequestError(f"the preset is '{shortened(request.preset)}', expected one of {', '.join(RENDER_PRESETS)}")
    if not 0.0 < request.scale <= 1.0:
        raise RequestError(f"the scale is {request.scale}, expected more than 0 and at most 1")
    shot: Shot = read_shot(io.BytesIO(request.shot))
    camera = shot.camera(0).scaled(request.scale)
    wanted = Passes(mattes=False, confidence=False)
    layers = ShotRenderer(models.of(shot), shot, RENDER_PRESETS[request.preset], wanted).render(0, camera)
    assert layers.depth is not None  # it is among what is wanted
    pixels = np.concatenate([layers.combined, layers.depth[..., None]], axis=-1).astype("<f4")
    content = pixels.tobytes()
    _say(
        out,
        {"event": "frame", "request": request.number, "preset": request.preset, "width": camera.width,
         "height": camera.height, "seconds": round(time.perf_counter() - began, 4), "bytes": len(content)},
        content,
    )  # fmt: skip


def _say(out: BinaryIO, event: dict[str, object], content: bytes = b"") -> None:
    out.write(json.dumps(event).encode() + b"\n" + content)
    out.flush()


def _warm(actor: Actor) -> None:
    """Renders a few pixels of a figure at rest, so that no request waits for kernels to be loaded or compiled."""
    person = next(iter(actor.persons.values()), None)
    things = list(actor.objects.values())[:1] if person is None else []
    bones = np.stack([translation(joint) for joint in person.rest_joints]) if person else np.zeros((0, 4, 4))
    pose = Pose(person.name if person else None, tuple(t.name for t in things), bones, np.eye(4)[None][: len(things)])
    centre = person.rest_joints.mean(axis=0) if person else np.zeros(3)
    intrinsics = np.array([[32.0, 0.0, 16.0], [0.0, 32.0, 16.0], [0.0, 0.0, 1.0]])
    camera = Camera(intrinsics, translation(centre - np.array([0.0, 0.0, 3.0])), 32, 32)
    actor.render(pose, camera, RENDER_PRESETS[WARM_PRESET])

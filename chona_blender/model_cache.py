"""The header of the model that the scene names, read once per version of the file.

Panels and searches look here; a file is opened only by `load`, which runs when the path changes, a .blend file is
loaded or an operator needs it, and by the thread that `watch` starts.
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import bpy

from . import looking
from .areas import redraw_areas
from .errors import ChonaError
from .model_header import ModelHeader, read_model_header

FRESH_SECONDS = 2.0
"""How long panels show a header before the file is looked at again; it may be trained or copied without us."""

Stamp = tuple[int, int]
"""A file's time in nanoseconds and its size: they tell that it is another one. Both are -1 where there is none."""


class _Known(NamedTuple):
    """What was found in a file: its header, or why that could not be read."""

    stamp: Stamp
    header: ModelHeader | None
    problem: str


_known: dict[str, _Known] = {}
_looked: dict[str, float] = {}


def _stamp_of(full: str) -> Stamp:
    try:
        found = Path(full).stat()
    except OSError:
        return -1, -1
    return found.st_mtime_ns, found.st_size


def _look_at(full: str, known: _Known | None) -> _Known:
    """The file as it is now; what is known of it where it has not changed. Touches nothing of Blender's."""
    stamp = _stamp_of(full)
    if known is not None and known.stamp == stamp and known.header is not None:
        return known
    try:
        return _Known(stamp, read_model_header(Path(full)), "")
    except ChonaError as error:
        return _Known(stamp, None, str(error))


def load(path: str) -> ModelHeader:
    """The header of the model file; a ChonaError says what is wrong with it."""
    if not path.strip():
        raise ChonaError(
            "no model file is set; choose the .safetensors file that a training wrote (sidebar CHONA ▸ Model)"
        )
    full = bpy.path.abspath(path)
    known = _known[full] = _look_at(full, _known.get(full))
    _looked[full] = time.monotonic()
    if known.header is None:
        raise ChonaError(known.problem)
    return known.header


def refresh(path: str) -> ModelHeader | None:
    """As `load`, for callers that show the error later."""
    if not path.strip():
        return None
    try:
        return load(path)
    except ChonaError:
        return None


def watch(path: str) -> None:
    """Have the file looked at again, unless that was a moment ago: panels and buttons ask while they are drawn."""
    if not path.strip():
        return
    if bpy.app.background:  # nothing is drawn, no timer runs, and nobody waits for a slow drive
        refresh(path)
    else:
        _look_later(path)


def _look_later(path: str) -> None:
    full, now = bpy.path.abspath(path), time.monotonic()
    if now - _looked.get(full, -FRESH_SECONDS) >= FRESH_SECONDS:
        _looked[full] = now
        looking.look(partial(_look_at, full, _known.get(full)), partial(_take, full))


def _take(full: str, found: _Known) -> None:
    """Another header is in a file that panels show: whoever is of that model shows its bones."""
    before, _known[full] = _known.get(full), found
    if before is not None and (before.stamp, before.problem) == (found.stamp, found.problem):
        return
    for scene in bpy.data.scenes:
        for actor in scene.chona.actors if scene.library is None else ():
            if found.header is not None and bpy.path.abspath(actor.model_path) == full:
                actor.refresh_bones()
    redraw_areas("VIEW_3D")


def cached(path: str) -> ModelHeader | None:
    """The header if it has been read; never opens a file."""
    known = _known.get(bpy.path.abspath(path))
    return None if known is None else known.header


def stamp(path: str) -> Stamp | None:
    """When the file whose header has been read was last changed, and its size; never opens a file."""
    known = _known.get(bpy.path.abspath(path))
    return None if known is None or known.header is None else known.stamp


def cached_error(path: str) -> str:
    """Why the file could not be read, if that has been tried."""
    known = _known.get(bpy.path.abspath(path))
    return "" if known is None else known.problem


def person_names(path: str) -> list[str]:
    """Names of the model's people."""
    header = cached(path) or refresh(path)
    return [] if header is None else list(header.persons)


def object_names(path: str) -> list[str]:
    """Names of the model's objects."""
    header = cached(path) or refresh(path)
    return [] if header is None else list(header.objects)


@bpy.app.handlers.persistent
def _file_loaded(*_: object) -> None:
    for scene in bpy.data.scenes:
        for actor in scene.chona.actors:
            refresh(actor.model_path)


def register() -> None:
    """Read the headers of the models that a loaded file names."""
    bpy.app.handlers.load_post.append(_file_loaded)


def unregister() -> None:
    """Stop listening and forget."""
    bpy.app.handlers.load_post.remove(_file_loaded)
    _known.clear()
    _looked.clear()

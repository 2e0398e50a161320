"""The header of the model that the scene names, read once per version of the file.

Panels and searches look here; a file is opened only by `refresh`, which runs when the path changes, a .blend file is
loaded or an operator needs it.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from .errors import ChonaError
from .model_header import ModelHeader, read_model_header

_headers: dict[str, tuple[float, ModelHeader]] = {}
_errors: dict[str, str] = {}


def load(path: str) -> ModelHeader:
    """The header of the model file; a ChonaError says what is wrong with it."""
    if not path.strip():
        raise ChonaError(
            "no model file is set; choose the .safetensors file that a training wrote (sidebar CHONA ▸ Model)"
        )
    full = bpy.path.abspath(path)
    try:
        stamp = Path(full).stat().st_mtime
    except OSError:
        stamp = -1.0
    known = _headers.get(full)
    if known is not None and known[0] == stamp:
        return known[1]
    _headers.pop(full, None)
    try:
        header = read_model_header(Path(full))
    except ChonaError as error:
        _errors[full] = str(error)
        raise
    _errors.pop(full, None)
    _headers[full] = (stamp, header)
    return header


def refresh(path: str) -> ModelHeader | None:
    """As `load`, for callers that show the error later."""
    if not path.strip():
        return None
    try:
        return load(path)
    except ChonaError:
        return None


def cached(path: str) -> ModelHeader | None:
    """The header if it has been read; never opens a file."""
    known = _headers.get(bpy.path.abspath(path))
    return None if known is None else known[1]


def stamp(path: str) -> float | None:
    """When the file whose header has been read was last changed; never opens a file."""
    known = _headers.get(bpy.path.abspath(path))
    return None if known is None else known[0]


def cached_error(path: str) -> str:
    """Why the file could not be read, if that has been tried."""
    return _errors.get(bpy.path.abspath(path), "")


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
    _headers.clear()
    _errors.clear()

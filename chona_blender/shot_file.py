"""A shot as a file (docs/file-formats.md), with numpy alone."""

from __future__ import annotations

import io
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .errors import ChonaError
from .rig.validation import Dropped

SUFFIX = ".shot.npz"


@dataclass(frozen=True)
class Shot:
    """A sampled shot, not yet written.

    Attributes:
        header: what the file's JSON header holds.
        arrays: the file's arrays without the header.
        dropped: scale and shear that was dropped, the worst first.
    """

    header: dict[str, Any]
    arrays: dict[str, np.ndarray]
    dropped: tuple[Dropped, ...]


def save_shot(path: str | Path, shot: Shot) -> Path:
    """Writes a shot under a temporary name and renames it; ``.shot.npz`` is appended where it is missing.

    Raises:
        ChonaError: the folder cannot be written to.
    """
    path = shot_path(path)
    write_npz(path, _arrays(shot))
    return path


def shot_bytes(shot: Shot) -> bytes:
    """The content of a shot's file, for a worker that takes it from a pipe."""
    content = io.BytesIO()
    np.savez(content, **_arrays(shot))
    return content.getvalue()


def _arrays(shot: Shot) -> dict[str, np.ndarray]:
    text = np.frombuffer(json.dumps(shot.header).encode("utf-8"), dtype=np.uint8)
    return {"header": text, **shot.arrays}


def shot_path(path: str | Path) -> Path:
    """``path`` with the suffix ``.shot.npz``."""
    path = Path(path)
    return path if path.name.endswith(SUFFIX) else path.with_name(path.name.removesuffix(".npz") + SUFFIX)


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes arrays under a temporary name beside ``path`` and renames: a reader never sees half a file.

    Raises:
        ChonaError: the folder cannot be written to.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)
        Path(temporary).replace(path)
        temporary = None
    except OSError as error:
        raise ChonaError(f"'{path}' cannot be written ({error.strerror}). Choose another folder") from error
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)

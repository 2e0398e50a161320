"""The one live worker: kept while its models, Python and device are the same, replaced when one of them changes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from .errors import ChonaError
from .live_worker import LiveWorker

CRASH_SECONDS = 60.0
"""A worker that ends again within this time of its predecessor's end is not replaced before somebody asks for it."""


@dataclass(frozen=True)
class Stamp:
    """A model's file: time and size tell that it is another one; both are -1 where there is none."""

    path: Path
    changed: int
    size: int

    @staticmethod
    def of(path: Path) -> Stamp:
        """As the file is now."""
        try:
            found = path.stat()
        except OSError:
            return Stamp(path, -1, -1)
        return Stamp(path, found.st_mtime_ns, found.st_size)


@dataclass(frozen=True)
class _Key:
    """What a worker was started with."""

    python: Path
    served: Stamp
    device: str


class _Kept:
    key: _Key | None = None
    worker: LiveWorker | None = None
    models: tuple[Stamp, ...] = ()
    replaced_at: float | None = None


def kept_worker(python: Path, models: tuple[Path, ...], device: str = "auto") -> tuple[LiveWorker, Path]:
    """The worker for some models, started unless it is there: there is one at a time.

    One that was ready and has ended is replaced, but not one after the other; one that never got ready is returned
    with its error, because what stopped it would stop the next one too.

    Args:
        models: at least one, absolute; a new worker is started with the first.

    Returns:
        the worker, and the one of the models that it was started with; the others a shot has to name.

    Raises:
        ChonaError: no model file, or the worker's Python does not start.
    """
    stamps = _Kept.models = tuple(Stamp.of(path) for path in models)
    missing = next((each.path for each in stamps if each.size < 0), None)
    if missing is not None:
        raise ChonaError(f"there is no model file {missing}; choose another one")
    key, old = _Kept.key, _Kept.worker
    same = key is not None and (key.python, key.device) == (python, device) and key.served in stamps
    if old is not None and key is not None and same:
        if old.alive or (old.error and not _may_replace(old)):
            return old, key.served.path
        if old.error:
            _Kept.replaced_at = time.monotonic()
    close_kept()
    arguments = ["serve", "--model", str(models[0]), *([] if device == "auto" else ["--device", device])]
    _Kept.worker = LiveWorker([str(python), "-m", "chona_model", *arguments])
    _Kept.key, _Kept.models = _Key(python, stamps[0], device), stamps
    return _Kept.worker, models[0]


def _may_replace(old: LiveWorker) -> bool:
    recently = _Kept.replaced_at is not None and time.monotonic() - _Kept.replaced_at < CRASH_SECONDS
    return old.was_ready and not recently


def kept_models() -> tuple[Stamp, ...]:
    """The files of the models that were asked for last."""
    return _Kept.models


def models_now() -> tuple[Stamp, ...]:
    """The same files as they are now."""
    return tuple(Stamp.of(each.path) for each in _Kept.models)


def close_kept() -> None:
    """End the kept worker, if there is one."""
    if _Kept.worker is not None:
        _Kept.worker.close()
    _Kept.worker = _Kept.key = None
    _Kept.models = ()


def start_again() -> None:
    """Forget a worker that ended, and that one did before it: the next who asks gets a new one."""
    close_kept()
    _Kept.replaced_at = None

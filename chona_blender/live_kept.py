"""The one live worker: kept while its model, Python and device are the same, replaced when one of them changes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .errors import ChonaError
from .live_worker import LiveWorker


@dataclass(frozen=True)
class _Key:
    """What a worker was started with; the model's time and size tell that the file is another one."""

    python: Path
    model: Path
    changed: int
    size: int
    device: str


class _Kept:
    key: _Key | None = None
    worker: LiveWorker | None = None


def kept_worker(python: Path, model: Path, device: str = "auto") -> LiveWorker:
    """The worker for a model, started unless it is there: there is one at a time.

    One that was ready and has ended is replaced; one that never got ready is returned with its error, because what
    stopped it would stop the next one too.

    Raises:
        ChonaError: no model file, or the worker's Python does not start.
    """
    try:
        found = model.stat()
    except OSError as error:
        raise ChonaError(f"there is no model file {model} ({error.strerror}); choose another one") from error
    key = _Key(python, model, found.st_mtime_ns, found.st_size, device)
    old = _Kept.worker
    if old is not None and _Kept.key == key and (old.alive or (old.error and not old.was_ready)):
        return old
    close_kept()
    arguments = ["serve", "--model", str(model), *([] if device == "auto" else ["--device", device])]
    _Kept.worker, _Kept.key = LiveWorker([str(python), "-m", "chona_model", *arguments]), key
    return _Kept.worker


def close_kept() -> None:
    """End the kept worker, if there is one."""
    if _Kept.worker is not None:
        _Kept.worker.close()
    _Kept.worker = _Kept.key = None

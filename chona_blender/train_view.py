"""What the panel shows of a training: the model beside the truth, above curves of quality and error.

Made when the training's files change, never while drawing.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from . import pictures
from .train_log import TrainLog, draw_curves, read_log

PICTURE = "chona.training"
LOG, PREVIEW, MODEL = "log.jsonl", "preview.png", "model.safetensors"
SIDE = 360
"""Pixels of the picture's sides."""
PREVIEW_SHARE = 0.55
"""Of its height, the part with the model and the truth."""
EVERY_SECONDS = 1.0
"""Files are looked at as often."""


class _Shown:
    """The folder whose picture the panel shows: the one of the selected training."""

    run: Path | None = None


def choose(run: Path | None) -> None:
    """Show the picture of a result folder from now on; none takes it away."""
    _Shown.run = run
    if run is None:
        pictures.forget(PICTURE)
    else:
        TrainView(run).follow(force=True)


class TrainView:
    """Follows the files of a result folder.

    Attributes:
        log: what the log said last.
    """

    def __init__(self, run: Path) -> None:
        self.run = run
        self.log: TrainLog = read_log(run / LOG)
        self._seen: tuple[float, ...] = ()
        self._looked = 0.0
        self._preview: np.ndarray | None = None

    def follow(self, force: bool = False) -> None:
        """Look at the files, and make the picture anew where they have changed."""
        now = time.monotonic()
        if not force and now - self._looked < EVERY_SECONDS:
            return
        self._looked = now
        stamps = tuple(_stamp(self.run / name) for name in (LOG, PREVIEW))
        if (stamps == self._seen and not force) or self.run != _Shown.run:
            return
        self.log = read_log(self.run / LOG)
        if not self._seen or stamps[1] != self._seen[1]:
            self._preview = _read(self.run / PREVIEW)
        self._seen = stamps
        if len(self.log.step):
            pictures.show(PICTURE, compose(self._preview, self.log))
        else:
            pictures.forget(PICTURE)


def compose(preview: np.ndarray | None, log: TrainLog, side: int = SIDE) -> np.ndarray:
    """[side, side, 3] in 0…1: the preview [H, W, 3] above the curves; curves alone where there is none."""
    if preview is None:
        return draw_curves(log, (side, side))
    height = round(side * PREVIEW_SHARE)
    scale = min(side / preview.shape[1], height / preview.shape[0])
    size = tuple(max(1, round(scale * length)) for length in preview.shape[:2])
    rows, columns = ((np.arange(new) * old / new).astype(int) for new, old in zip(size, preview.shape[:2], strict=True))
    top = np.broadcast_to(np.array(pictures.BACKGROUND), (height, side, 3)).copy()
    left, above = (side - size[1]) // 2, (height - size[0]) // 2
    top[above : above + size[0], left : left + size[1]] = preview[rows[:, None], columns]
    return np.concatenate([top, draw_curves(log, (side, side - height))])


def _read(path: Path) -> np.ndarray | None:
    try:
        return pictures.read(path) if path.is_file() else None
    except RuntimeError:  # being replaced this very moment: the next look finds it
        return None


def _stamp(path: Path) -> float:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return -1.0

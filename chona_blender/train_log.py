"""A training's ``log.jsonl`` as arrays, and as a plot of how error and quality went."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .glyphs import write

PSNR_COLOUR, LOSS_COLOUR, PREVIEW_COLOUR = (0.35, 0.68, 1.0), (1.0, 0.62, 0.22), (1.0, 1.0, 1.0)
GROUND, GRID, WORDS = (0.11, 0.11, 0.11), (0.2, 0.2, 0.2), (0.6, 0.6, 0.6)
LEFT, TOP, RIGHT, BOTTOM = 50, 8, 8, 18
"""Pixels around a plot, for its numbers."""
LARGEST_LOG = 1 << 23
"""Bytes: of a larger one, which no training writes, the end is read."""
BOUNDS = {"step": (0, 1e12), "loss": (-1e12, 1e12), "psnr": (-1000.0, 1000.0)}
SMOOTHING = 0.15
"""Weight of a new value in the bright curve; the dim one has every value."""


@dataclass(frozen=True)
class TrainLog:
    """How a training went, N lines.

    Attributes:
        step: [N] steps done; loss, psnr: [N] of the rays of that step, dB; preview_psnr: [N] dB, NaN where no preview
            was drawn.
    """

    step: np.ndarray
    loss: np.ndarray
    psnr: np.ndarray
    preview_psnr: np.ndarray


def read_log(path: Path) -> TrainLog:
    """What a log says so far; nothing where there is none, and without a last line that is still being written.

    What no training writes is left out: steps that do not grow, numbers of no possible size.
    """
    rows: list[tuple[float, ...]] = []
    for line in _last_part(path).splitlines():
        try:
            entry = json.loads(line)
            step, loss, psnr = (_within(entry[name], name) for name in ("step", "loss", "psnr"))
            preview = entry.get("preview_psnr")
            row = step, loss, psnr, np.nan if preview is None else _within(preview, "psnr")
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
        if not rows or step > rows[-1][0]:
            rows.append(row)
    return TrainLog(*np.array(rows, dtype=np.float64).reshape(-1, 4).T)


def _last_part(path: Path) -> str:
    try:
        with path.open("rb") as file:
            file.seek(max(path.stat().st_size - LARGEST_LOG, 0))
            return file.read(LARGEST_LOG).decode("utf-8", "replace")
    except OSError:
        return ""


def _within(value: object, name: str) -> float:
    low, high = BOUNDS[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{name} out of bounds")
    return float(value)


def smoothed(values: np.ndarray) -> np.ndarray:
    """A running mean in which older values fade; the first ones are means of all before them."""
    result, mean = np.empty(len(values)), 0.0
    for index, value in enumerate(values):
        mean += (value - mean) * max(SMOOTHING, 1.0 / (index + 1))
        result[index] = mean
    return result


@dataclass(frozen=True)
class Scale:
    """Where values lie in a plot of ``size`` (width, height) pixels: numbers at ``marks`` are written beside it."""

    size: tuple[int, int]
    last_step: float
    low: float
    high: float
    marks: tuple[float, ...]

    def columns(self, step: np.ndarray) -> np.ndarray:
        """Of steps, pixels from the left."""
        return LEFT + np.asarray(step) / self.last_step * (self.size[0] - LEFT - RIGHT - 1)

    def rows(self, value: np.ndarray) -> np.ndarray:
        """Of values, pixels from the top."""
        share = (self.high - np.asarray(value)) / (self.high - self.low)
        return TOP + share * (self.size[1] - TOP - BOTTOM - 1)


def psnr_scale(values: np.ndarray, last_step: float, size: tuple[int, int]) -> Scale:
    """From and to multiples of 5 dB."""
    low, high = _around(values, 5.0)
    return Scale(size, last_step, low, high, tuple(np.arange(low, high + 1.0, 5.0)))


def loss_scale(logarithms: np.ndarray, last_step: float, size: tuple[int, int]) -> Scale:
    """From and to powers of ten."""
    low, high = _around(logarithms, 1.0)
    return Scale(size, last_step, low, high, tuple(np.arange(low, high + 0.5, 1.0)))


def _around(values: np.ndarray, unit: float) -> tuple[float, float]:
    if not len(values):
        return 0.0, unit
    low, high = (float(side(values)) / unit for side in (np.min, np.max))
    return np.floor(low) * unit, max(np.ceil(high), np.floor(low) + 1.0) * unit


def draw_curves(log: TrainLog, size: tuple[int, int]) -> np.ndarray:
    """[H, W, 3] in 0…1: quality above error, over the steps.

    Args:
        size: width and height in pixels.
    """
    width, height = size
    half = height // 2
    last = max(float(log.step[-1]), 1.0) if len(log.step) else 1.0
    shown = np.isfinite(log.preview_psnr)
    upper = psnr_scale(np.concatenate([log.psnr, log.preview_psnr[shown]]), last, (width, half))
    logarithm = np.log10(np.maximum(log.loss, 1e-9))
    lower = loss_scale(logarithm, last, (width, height - half))
    top = _plot(upper, log.step, log.psnr, PSNR_COLOUR, "PSNR DB", [f"{mark:.0f}" for mark in upper.marks])
    _line(top, upper, log.step[shown], log.preview_psnr[shown], PREVIEW_COLOUR)
    marks = [f"{10.0**mark:g}" for mark in lower.marks]
    bottom = _plot(lower, log.step, logarithm, LOSS_COLOUR, "LOSS", marks)
    return np.concatenate([top, bottom])


def _plot(
    scale: Scale, step: np.ndarray, value: np.ndarray, colour: tuple, title: str, numbers: list[str]
) -> np.ndarray:
    width, height = scale.size
    image = np.broadcast_to(np.array(GROUND), (height, width, 3)).copy()
    for mark, number in zip(scale.marks, numbers, strict=True):
        row = round(float(scale.rows(mark)))
        image[row, LEFT : width - RIGHT] = GRID
        write(image, number, (LEFT - 5, row), WORDS, align="right")
    write(image, f"{scale.last_step:.0f}", (width - RIGHT, height - BOTTOM // 2 + 1), WORDS, align="right")
    write(image, "STEP", (LEFT, height - BOTTOM // 2 + 1), WORDS)
    dim = tuple(0.4 * part + 0.6 * ground for part, ground in zip(colour, GROUND, strict=True))
    _line(image, scale, step, value, dim, thickness=1)
    _line(image, scale, step, smoothed(value), colour)
    rises = len(value) > 0 and value[-1] > value[0]  # the title goes where the curve is not
    write(image, title, (width - RIGHT - 4, height - BOTTOM - 10 if rises else TOP + 9), colour, align="right")
    return image


def _line(
    image: np.ndarray, scale: Scale, step: np.ndarray, value: np.ndarray, colour: tuple, thickness: int = 2
) -> None:
    """A line through points, a pixel column at a time; a single point is a dot."""
    if not len(step):
        return
    place = scale.columns(step)
    columns = np.arange(round(float(place[0])), round(float(place[-1])) + 1)
    rows = np.interp(columns, place, scale.rows(value))
    before = np.concatenate([rows[:1], rows[:-1]])
    middle = (before + rows) / 2.0
    after = np.concatenate([middle[1:], rows[-1:]])
    for column, start, row, end in zip(columns, middle, rows, after, strict=True):
        low, high = round(min(start, row, end)), round(max(start, row, end))
        image[max(low, 0) : high + thickness, column] = colour

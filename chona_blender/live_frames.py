"""The answers of a live worker: events, and after each `frame` its picture in bytes (docs/file-formats.md)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

from .errors import ChonaError
from .events import clean, parse_event, read_lines

CHANNELS = 5
PIXEL_BYTES = 4 * CHANNELS
LARGEST_FRAME = 1 << 29
"""Bytes, 5160 x 5160 pixels: a worker that announces more is not understood."""
READ_BYTES = 1 << 24
"""So many are read at once, by whole rows."""
SHOWN = 80
"""Characters of an answer that are repeated in an error."""


@dataclass(frozen=True)
class Frame:
    """A picture that has come.

    Attributes:
        number: of the request it answers.
        preset: it was rendered with.
        rgba: [H, W, 4] float32, scene-linear, premultiplied, the top row first.
        depth: [H, W] float32 along the camera axis, metres; 1e10 where empty.
        seconds: the worker needed for it.
        arrived: `time.monotonic()` when it was there.
    """

    number: int
    preset: str
    rgba: np.ndarray
    depth: np.ndarray
    seconds: float
    arrived: float


def read_answers(pipe: IO[bytes], keep: Callable[[str], None]) -> Iterator[tuple[dict[str, Any], Frame | None]]:
    """Every event, with its picture where it has one.

    Args:
        keep: is given what is printed before the worker is ready.

    Raises:
        ChonaError: an answer is not understood, so where the next one begins is not known.
    """
    ready = False
    for line in read_lines(pipe):
        event = parse_event(line)
        if event is None and ready:
            raise ChonaError(f"the worker's answer is not understood: {clean(line[:SHOWN])!r}")
        if event is None:
            keep(clean(line))
            continue
        ready = ready or event["event"] == "ready"
        yield event, _read_frame(event, pipe) if event["event"] == "frame" else None


def _read_frame(event: dict[str, Any], pipe: IO[bytes]) -> Frame:
    width, height, size = event["width"], event["height"], event["bytes"]
    if size != width * height * PIXEL_BYTES or not 0 < size <= LARGEST_FRAME:
        raise ChonaError(f"the worker's answer is not understood: {size} bytes for {width} x {height} pixels")
    rgba, depth = np.empty((height, width, 4), np.float32), np.empty((height, width), np.float32)
    rows = max(1, READ_BYTES // (width * PIXEL_BYTES))
    for top in range(0, height, rows):
        part = slice(top, min(top + rows, height))
        wanted = (part.stop - top) * width * PIXEL_BYTES
        content = pipe.read(wanted)
        if len(content) < wanted:
            raise ChonaError(f"the worker's picture is not whole: it ends after {top} of {height} rows")
        pixels = np.frombuffer(content, "<f4").reshape(-1, width, CHANNELS)
        rgba[part], depth[part] = pixels[..., :4], pixels[..., 4]
    return Frame(event["request"], event["preset"], rgba, depth, event["seconds"], time.monotonic())

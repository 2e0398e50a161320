"""How a training goes, as a picture: one of its views beside what the model makes of it, every few seconds.

The view stays the same for the whole training, and is one that is trained on: to hold one out would train another
model.  Nothing random is drawn and no tensor is written to, so a training with previews ends with the same model, bit
for bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from chona_model.actor import Actor
from chona_model.data.dataset import Dataset, View
from chona_model.data.images import Pixels, load_pixels
from chona_model.formats.picture import save_picture
from chona_model.settings import RENDER_PRESETS
from chona_model.train.errors import decibels

NAME = "preview.png"
SIDE = 256
"""Pixels of the longer side of either half, at most."""
LOOKED_AT = 8
"""Views among which the one that shows most is chosen."""
MARGIN = 0.08
"""Around the figure, as a share of its size."""
LARGEST_SHARE = 0.1
"""Of the time that previews may take; where one takes long, the next comes later."""


class Preview:
    """Draws ``RUN/preview.png``: on the left the truth without its background, on the right the model.

    Args:
        dataset: what is trained on; run: the run's folder; every: seconds between two pictures.
        clock: seconds that only grow.

    Raises:
        DatasetError: an image is damaged.
    """

    def __init__(
        self, dataset: Dataset, run: Path, every: float, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self.path, self.every, self._clock = run / NAME, every, clock
        view, seen = _most_seen(dataset.views)
        rows, columns = (np.flatnonzero(seen.mask.any(axis)) for axis in (1, 0))
        box = _widened(rows, view.camera.height), _widened(columns, view.camera.width)
        scale = min(1.0, SIDE / max(box[0][1] - box[0][0], box[1][1] - box[1][0]))
        self._pose, self._camera = view.pose, view.camera.scaled(scale)
        size = self._camera.height, self._camera.width
        self._part = tuple(_scaled(span, scale, most) for span, most in zip(box, size, strict=True))
        self._truth = (load_pixels(view, scale) if scale < 1.0 else seen).rgb[self._part]
        self._inside = np.zeros(size, dtype=bool)
        self._inside[self._part] = True
        self._next = clock()

    def due(self) -> bool:
        """Whether it is time for another picture."""
        return self._clock() >= self._next

    def draw(self, actor: Actor) -> float:
        """Writes the picture, whole or not at all; returns its PSNR inside the picture's frame, dB."""
        began = self._clock()
        with torch.no_grad():
            picture = actor.render(self._pose, self._camera, RENDER_PRESETS["preview"], self._inside)
        shown = np.clip(picture.rgb[self._part], 0.0, 1.0)
        save_picture(self.path, np.concatenate([self._truth, shown], axis=1))
        ended = self._clock()
        self._next = ended + max(self.every, (ended - began) * (1.0 / LARGEST_SHARE - 1.0))
        return decibels(float(((shown - self._truth) ** 2).mean()))


def _most_seen(views: Sequence[View]) -> tuple[View, Pixels]:
    """Of some views spread over all, the one whose masks cover most of it; an earlier one wins."""
    places = np.linspace(0, len(views) - 1, min(len(views), LOOKED_AT)).round().astype(int)
    looked_at = [(views[place], load_pixels(views[place])) for place in places]
    return max(looked_at, key=lambda pair: float(pair[1].mask.mean()))


def _widened(filled: np.ndarray, most: int) -> tuple[int, int]:
    """First and one past the last of the rows (or columns) to show; all of them where the masks are empty."""
    if not len(filled):
        return 0, most
    margin = MARGIN * (filled[-1] + 1 - filled[0])
    return max(int(filled[0] - margin), 0), min(int(np.ceil(filled[-1] + 1 + margin)), most)


def _scaled(span: tuple[int, int], scale: float, most: int) -> slice:
    """A span of pixels on an image of ``most`` pixels that is ``scale`` times as large; never empty."""
    first = min(int(span[0] * scale), most - 1)
    return slice(first, min(max(int(np.ceil(span[1] * scale)), first + 1), first + SIDE, most))

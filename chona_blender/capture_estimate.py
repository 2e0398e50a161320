"""What a capture will take: one of its frames is rendered from two cameras, timed and weighed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from bpy.types import Scene

from .capture import Cast, Performance, Stage, performance, stage, write_surface
from .capture_files import finished_frames
from .capture_settings import CaptureSettings
from .shot_file import write_npz

PROBED = 2
"""Cameras that are tried: one sees the figure from the front, one from the side."""


@dataclass(frozen=True)
class CaptureEstimate:
    """What lies before a capture.

    Attributes:
        frames, cameras: of the sequence; finished: frames that are there and will be skipped.
        seconds: of sampling and rendering; bytes: of what is not there yet.
        warnings: see ``CaptureResult``.
    """

    frames: int
    cameras: int
    finished: int
    seconds: float
    bytes: int
    warnings: tuple[str, ...]

    @property
    def images(self) -> int:
        """Colour images that will be rendered, each with its masks."""
        return (self.frames - self.finished) * self.cameras


def estimate_capture(
    scene: Scene, cast: Cast, settings: CaptureSettings, *, clock: Callable[[], float] = time.perf_counter
) -> CaptureEstimate:
    """Renders the middle frame from two cameras at full size and quality into a temporary folder.

    A render before them, of one sample, is not counted for every image: it loads kernels and builds what is kept.

    Raises:
        ChonaError: whatever ``capture_sequence`` would refuse.
    """
    folder = Path(settings.folder) / "sequences" / settings.sequence_name
    began = clock()
    with performance(scene, cast, settings) as shown, TemporaryDirectory(prefix="chona_probe_") as temporary:
        place = Path(temporary)
        finished = len(finished_frames(folder, shown.description, shown.arrays))
        write_surface(scene, shown, place / "person.npz")
        write_npz(place / "poses.npz", shown.arrays)
        fixed = sum((place / name).stat().st_size for name in ("person.npz", "poses.npz"))
        missing = len(shown.frames) - finished
        prepared = clock() - began
        if not missing:
            return CaptureEstimate(len(shown.frames), len(shown.cameras), finished, prepared, 0, shown.warnings)
        with stage(scene, shown, settings) as stands:
            with _one_sample(stands):
                _timed(clock, lambda: stands.set_frame(int(shown.frames[0])))
                warm = _timed(clock, lambda: stands.render(shown.cameras[0], place / "warm"))
            to_frame = _timed(clock, lambda: stands.set_frame(int(shown.frames[len(shown.frames) // 2])))
            seconds, sizes = zip(*(_probe(clock, shown, stands, place, index) for index in _places(shown)), strict=True)
    images = missing * len(shown.cameras)
    return CaptureEstimate(
        len(shown.frames), len(shown.cameras), finished,
        prepared + warm + missing * to_frame + images * float(np.mean(seconds)),
        fixed + round(images * float(np.mean(sizes))), shown.warnings,
    )  # fmt: skip


def _places(shown: Performance) -> list[int]:
    count = min(PROBED, len(shown.cameras))
    return sorted({index * len(shown.cameras) // (2 * count) for index in range(count)})


def _probe(clock: Callable[[], float], shown: Performance, stands: Stage, place: Path, index: int) -> tuple[float, int]:
    """Seconds and bytes of a camera's images."""
    stem = place / f"probe_{index}"
    seconds = _timed(clock, lambda: stands.render(shown.cameras[index], stem))
    return seconds, sum(path.stat().st_size for path in place.glob(f"{stem.name}.*"))


def _timed(clock: Callable[[], float], work: Callable[[], object]) -> float:
    began = clock()
    work()
    return clock() - began


@contextmanager
def _one_sample(stands: Stage) -> Iterator[None]:
    before = [scene.cycles.samples for scene in (stands.colour, stands.masks)]
    try:
        for scene in (stands.colour, stands.masks):
            scene.cycles.samples = 1
        yield
    finally:
        for scene, samples in zip((stands.colour, stands.masks), before, strict=True):
            scene.cycles.samples = samples


def size_words(count: float) -> str:
    """`940 kB`, `84 MB`, `2.1 GB`."""
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.1f} {unit}" if count < 10 * size else f"{count / size:.0f} {unit}"
    return f"{max(1, round(count / 1e3))} kB" if count else "nothing"

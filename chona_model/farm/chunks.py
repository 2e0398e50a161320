"""Frame numbers in chunks, as ``--frames`` takes them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby


def chunks_of(frames: Sequence[int], size: int) -> list[str]:
    """``[1, 2, 3, 7]`` in chunks of 3 -> ``["1-3", "7"]``; the frames are increasing."""
    return [_merged(frames[start : start + size]) for start in range(0, len(frames), size)]


def _merged(frames: Sequence[int]) -> str:
    runs = groupby(enumerate(frames), key=lambda pair: pair[1] - pair[0])
    ends = [(run[0][1], run[-1][1]) for run in (list(group) for _, group in runs)]
    return ",".join(str(first) if first == last else f"{first}-{last}" for first, last in ends)

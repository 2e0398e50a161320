"""Which frames of a bake have files already, for panels."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

from . import looking
from .areas import redraw_areas
from .errors import ChonaError
from .frames import find_baked_frames
from .output import Output

FRESH_SECONDS = 2.0
"""How long an answer holds; files may come and go without us."""


class _Known:
    output: Output | None = None
    numbers: frozenset[int] | None = None
    seen = 0.0
    looks_at: Output | None = None


def numbers_in(folder: Path, name: str) -> frozenset[int]:
    """The numbers of a bake's files, negative ones too; none where there is no such folder."""
    try:
        found = find_baked_frames(folder, name)
    except (ChonaError, OSError):
        return frozenset()
    return frozenset((*found.numbers, *found.negative))


def known(output: Output) -> frozenset[int] | None:
    """The numbers as they were last seen, None before the first look; asks for another look where that was long ago."""
    if _Known.output != output:
        _Known.output, _Known.numbers, _Known.seen = output, None, 0.0
    if _Known.looks_at is None and time.monotonic() - _Known.seen > FRESH_SECONDS:
        _Known.looks_at = output
        looking.look(partial(numbers_in, output.folder, output.name), _take)
    return _Known.numbers


def look_again() -> None:
    """A bake has ended: what is known is old."""
    _Known.seen = 0.0


def _take(numbers: frozenset[int]) -> None:
    looked_at, _Known.looks_at = _Known.looks_at, None
    if looked_at == _Known.output:
        changed = numbers != _Known.numbers
        _Known.numbers, _Known.seen = numbers, time.monotonic()
        if changed:
            redraw_areas("VIEW_3D")


def forget() -> None:
    """Drop everything: the add-on is switched off."""
    _Known.output = _Known.numbers = _Known.looks_at = None
    _Known.seen = 0.0

"""Which frames of a bake have files already, for panels: a thread looks into the folder, drawing only asks.

The folder may be on a slow network drive, and panels are drawn with every movement of the mouse.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path

import bpy

from .errors import ChonaError
from .frames import find_baked_frames
from .jobs import redraw_sidebars
from .output import Output

FRESH_SECONDS = 2.0
"""How long an answer holds; files may come and go without us."""

DELIVER_SECONDS = 0.1


class _Look:
    """One look into a folder; `numbers` is there once the thread has ended."""

    def __init__(self, output: Output) -> None:
        self.output = output
        self.numbers: frozenset[int] = frozenset()
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        self.numbers = numbers_in(self.output.folder, self.output.name)


class _Known:
    output: Output | None = None
    numbers: frozenset[int] | None = None
    seen = 0.0
    look: _Look | None = None


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
    if _Known.look is None and time.monotonic() - _Known.seen > FRESH_SECONDS:
        _Known.look = _Look(output)
    if _Known.look is not None and not bpy.app.timers.is_registered(_deliver):  # a file that is opened ends timers
        bpy.app.timers.register(_deliver, first_interval=DELIVER_SECONDS)
    return _Known.numbers


def look_again() -> None:
    """A bake has ended: what is known is old."""
    _Known.seen = 0.0


def _deliver() -> float | None:
    look = _Known.look
    if look is None:
        return None
    if look.thread.is_alive():
        return DELIVER_SECONDS
    _Known.look = None
    if look.output == _Known.output:
        changed = look.numbers != _Known.numbers
        _Known.numbers, _Known.seen = look.numbers, time.monotonic()
        if changed:
            redraw_sidebars(bpy.context)
    return None


def forget() -> None:
    """Drop everything: the add-on is switched off."""
    if bpy.app.timers.is_registered(_deliver):
        bpy.app.timers.unregister(_deliver)
    _Known.output = _Known.numbers = _Known.look = None
    _Known.seen = 0.0

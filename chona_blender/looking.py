"""Looks at files in a thread, for panels: drawing only asks, and a timer hands over what was found.

Files may be on a slow network drive, and panels are drawn with every movement of the mouse.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

import bpy

DELIVER_SECONDS = 0.1
Found = TypeVar("Found")


class _Look(Generic[Found]):
    """One look; `found` is there once the thread has ended."""

    def __init__(self, find: Callable[[], Found], take: Callable[[Found], None]) -> None:
        self._find, self._take = find, take
        self._found: list[Found] = []
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        self._found.append(self._find())

    def deliver(self) -> None:
        """Hand over what was found; the thread has ended."""
        for found in self._found:
            self._take(found)


_under_way: list[_Look] = []


def look(find: Callable[[], Found], take: Callable[[Found], None]) -> None:
    """Run ``find``, which touches nothing of Blender's, in a thread, and ``take`` with its answer in the main one."""
    _under_way.append(_Look(find, take))
    if not bpy.app.timers.is_registered(_deliver):
        bpy.app.timers.register(_deliver, first_interval=DELIVER_SECONDS, persistent=True)


def _deliver() -> float | None:
    for each in [each for each in _under_way if not each.thread.is_alive()]:
        _under_way.remove(each)
        each.deliver()
    return DELIVER_SECONDS if _under_way else None


def forget() -> None:
    """Take no more answers: the add-on is switched off."""
    if bpy.app.timers.is_registered(_deliver):
        bpy.app.timers.unregister(_deliver)
    _under_way.clear()

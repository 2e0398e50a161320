"""Driving the real Blender with a window from a script: the sidebar, pictures of the screen, waiting, an end.

Pictures are taken with `scrot`, because Blender's own screenshot is black under software OpenGL.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy

ADDON = "bl_ext.user_default.chona"
"""The add-on's name as an extension."""


@dataclass
class Drive:
    """A story that is told step by step: each `yield` of it lets Blender go on for so many seconds.

    Attributes:
        out: folder for the pictures and ``answer.json``.
        answer: what was seen, for the test.
    """

    out: Path
    answer: dict[str, Any] = field(default_factory=dict)
    pictures: list[str] = field(default_factory=list)

    def run(self, story: Iterator[float]) -> None:
        """Tell the story in the event loop and end Blender, with 9 where the story failed."""

        def step() -> float | None:
            try:
                return next(story)
            except StopIteration:
                self._leave(0)
            except Exception:
                self.answer["failure"] = traceback.format_exc()
                self._screen("99_failure")
                self._leave(9)
            return None

        bpy.context.preferences.view.show_splash = False
        bpy.app.timers.register(step, first_interval=1.0, persistent=True)  # a file may be loaded in the story

    def picture(self, name: str, redraws: int = 5) -> Iterator[float]:
        """A numbered picture of the screen, after everything was drawn: panels slide to their places."""
        for _ in range(redraws):
            for area in window().screen.areas:
                area.tag_redraw()
            yield 0.3
        self._screen(f"{len(self.pictures) + 1:02d}_{name}")

    def _screen(self, name: str) -> None:
        subprocess.run(["xdotool", "mousemove", "4", "4"], check=True)  # no tooltips
        subprocess.run(["scrot", "-o", str(self.out / f"{name}.png")], check=True)
        self.pictures.append(name)

    def save(self) -> None:
        """Write what was seen so far."""
        (self.out / "answer.json").write_text(json.dumps(self.answer | {"pictures": self.pictures}, indent=1))

    def _leave(self, code: int) -> None:
        self.save()
        os._exit(code)


def module(name: str) -> Any:
    """One of the installed add-on's modules."""
    return sys.modules[f"{ADDON}.{name}"]


def show_only(panels: Any, names: Collection[str]) -> None:
    """Take the sidebar's other panels away, to have room for some; ``panels`` is the add-on's module."""
    for cls in reversed(panels.CLASSES):  # those that stand inside others first
        if issubclass(cls, bpy.types.Panel) and cls.__name__ not in names:
            bpy.utils.unregister_class(cls)


def window() -> bpy.types.Window:
    """The only window."""
    return bpy.context.window_manager.windows[0]


def view_area() -> bpy.types.Area:
    """The 3D view."""
    return next(area for area in window().screen.areas if area.type == "VIEW_3D")


def region_of(area: bpy.types.Area, kind: str = "UI") -> bpy.types.Region:
    """The sidebar of an area, or its main region (WINDOW)."""
    return next(region for region in area.regions if region.type == kind)


def call(operator: str, *arguments: str, **options: object) -> list[str]:
    """An operator, as `chona.bake`, as a click in the sidebar calls it."""
    family, name = operator.split(".")
    area = view_area()
    with bpy.context.temp_override(window=window(), area=area, region=region_of(area)):
        return sorted(getattr(getattr(bpy.ops, family), name)(*arguments, **options))


def show_sidebar() -> Iterator[float]:
    """The sidebar on our tab."""
    area = view_area()
    area.spaces.active.show_region_ui = True
    yield 0.5
    region_of(area).active_panel_category = "CHONA"
    area.tag_redraw()
    yield 0.5


def until(condition: Callable[[], object], seconds: float, every: float = 0.2) -> Iterator[float]:
    """Wait for something; TimeoutError when it does not come."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {seconds:g} s for {condition}")
        yield every

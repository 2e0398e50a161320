"""What all panels share: the tab they stand in, and words over several lines."""

from __future__ import annotations

import blf
import bpy

UI_FONT = 0
BESIDE_TEXT, LEAST_TEXT = 104.0, 80.0
"""Pixels at scale 1: margins, a box and an icon beside a text; and the least width that is left for it."""


class Sidebar:
    """A panel in the tab CHONA of the 3D view."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "CHONA"

    layout: bpy.types.UILayout

    def columns(self) -> bpy.types.UILayout:
        """A column with labels on the left, as in Blender's own panels."""
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        return self.layout.column()


def wrapped(layout: bpy.types.UILayout, text: str, icon: str, context: bpy.types.Context | None) -> None:
    """A text over as many lines as the panel's width needs; labels do not wrap by themselves."""
    scale = bpy.context.preferences.system.ui_scale or 1.0  # 0 without a window
    width = 320.0 * scale if context is None or context.region is None else float(context.region.width)
    blf.size(UI_FONT, bpy.context.preferences.ui_styles[0].widget.points * scale)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for index, line in enumerate(_lines(text, max(width - BESIDE_TEXT * scale, LEAST_TEXT * scale))):
        column.label(text=line, icon=icon if index == 0 else "BLANK1")


def _lines(text: str, width: float) -> list[str]:
    """A text broken at spaces, and inside words that are wider than a line: paths have no spaces."""
    lines, line = [], ""
    for word in text.split():
        rest = word
        longer = f"{line} {rest}" if line else rest
        if _width(longer) <= width:
            line = longer
            continue
        if line:
            lines.append(line)
        while _width(rest) > width and len(rest) > 1:
            fitting = next(
                count for count in range(len(rest) - 1, 0, -1) if count == 1 or _width(rest[:count]) <= width
            )
            lines.append(rest[:fitting])
            rest = rest[fitting:]
        line = rest
    return [*lines, line] if line else lines


def _width(text: str) -> float:
    """Pixels of a text in the interface's font."""
    return blf.dimensions(UI_FONT, text)[0]

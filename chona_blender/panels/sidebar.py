"""What all panels share: the tab they stand in, and words over several lines."""

from __future__ import annotations

import bpy


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
    width = 320.0 if context is None or context.region is None else float(context.region.width)
    scale = bpy.context.preferences.system.ui_scale
    most = max(int((width / scale - 70.0) / 6.0), 16)
    lines, line = [], ""
    for word in text.split():
        part = word
        while len(part) > most:  # paths have no spaces
            if line:
                lines.append(line)
            lines.append(part[:most])
            part, line = part[most:], ""
        if len(line) + len(part) + 1 > most and line:
            lines.append(line)
            line = part
        else:
            line = f"{line} {part}".strip()
    if line:
        lines.append(line)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for index, each in enumerate(lines):
        column.label(text=each, icon=icon if index == 0 else "BLANK1")

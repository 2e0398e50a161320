"""Areas of all windows, to be drawn again."""

from __future__ import annotations

import bpy


def redraw_areas(kind: str) -> None:
    """Have every area of a kind, as `VIEW_3D`, drawn again with its sidebar, in every window."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == kind:
                area.tag_redraw()

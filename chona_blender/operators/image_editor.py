"""Shows an image where users look for one."""

from __future__ import annotations

from pathlib import Path

import bpy


def load_anew(path: str | Path) -> bpy.types.Image:
    """The image of a file as the file is now, also where it was loaded before.

    Raises:
        RuntimeError: Blender cannot read it.
    """
    image = bpy.data.images.load(str(path), check_existing=True)
    image.reload()
    return image


def show_image(context: bpy.types.Context, image: bpy.types.Image, new_window: bool = True) -> bpy.types.Area | None:
    """In an image editor that is there, or in a window of its own; returns the editor, None where there is no place."""
    if bpy.app.background or context.window is None:
        return None
    window, area = context.window, None
    for window in context.window_manager.windows:
        area = next((each for each in window.screen.areas if each.type == "IMAGE_EDITOR"), None)
        if area is not None:
            break
    if area is None:
        if not new_window:
            return None
        bpy.ops.wm.window_new()
        window = context.window_manager.windows[-1]
        area = window.screen.areas[0]
        area.type = "IMAGE_EDITOR"
    area.spaces.active.image = image
    region = next(each for each in area.regions if each.type == "WINDOW")
    with context.temp_override(window=window, area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)
    return area

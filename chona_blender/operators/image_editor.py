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


def image_editor(context: bpy.types.Context) -> tuple[bpy.types.Window, bpy.types.Area] | None:
    """An image editor that is open, and its window."""
    areas = ((window, area) for window in context.window_manager.windows for area in window.screen.areas)
    return next((each for each in areas if each[1].type == "IMAGE_EDITOR"), None)


def show_image(context: bpy.types.Context, image: bpy.types.Image, new_window: bool = True) -> bpy.types.Area | None:
    """In an image editor that is there, or in a window of its own; returns the editor, None where there is no place."""
    if bpy.app.background or context.window is None:
        return None
    found = image_editor(context)
    if found is None:
        if not new_window:
            return None
        bpy.ops.wm.window_new()
        window = context.window_manager.windows[-1]
        found = window, window.screen.areas[0]
        found[1].type = "IMAGE_EDITOR"
    window, area = found
    area.spaces.active.image = image
    region = next(each for each in area.regions if each.type == "WINDOW")
    with context.temp_override(window=window, area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)
    return area

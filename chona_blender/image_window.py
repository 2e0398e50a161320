"""Shows an image file in an image editor."""

from __future__ import annotations

from pathlib import Path

import bpy

from .errors import ChonaError


def show(context: bpy.types.Context, path: Path | None) -> None:
    """In an image editor that is there, or in a window of its own; without a window the image is only loaded.

    Raises:
        ChonaError: the file is not there, or is no image.
    """
    if path is None or not path.is_file():
        raise ChonaError(f"there is no picture {path or ''} any more; make it again".replace("  ", " "))
    try:
        image = bpy.data.images.load(str(path), check_existing=True)
    except RuntimeError as error:
        raise ChonaError(str(error)) from error
    image.reload()  # written again since it was shown last
    if bpy.app.background or context.window is None:
        return
    window = context.window
    area = next((each for each in window.screen.areas if each.type == "IMAGE_EDITOR"), None)
    if area is None:
        bpy.ops.wm.window_new()
        window = context.window_manager.windows[-1]
        area = window.screen.areas[0]
        area.type = "IMAGE_EDITOR"
    area.spaces.active.image = image
    region = next(each for each in area.regions if each.type == "WINDOW")
    with context.temp_override(window=window, area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)

"""Baked frames as an image of Blender's: a sequence that follows the scene's frame."""

from __future__ import annotations

import bpy

from .errors import ChonaError
from .frames import BakedFrames, find_baked_frames
from .output import Output


def baked_frames(output: Output) -> BakedFrames:
    """The frames that can be shown.

    Raises:
        ChonaError: there are none, or only such below 0.
    """
    frames = find_baked_frames(output.folder, output.name)
    if not frames.numbers:
        raise ChonaError(f"{output.folder} has only frames below 0, which Blender's image sequences cannot show")
    return frames


def baked_image(frames: BakedFrames) -> bpy.types.Image:
    """The sequence of a bake's frames; the same image for the same files, read anew."""
    path = str(frames.path(frames.numbers[0]))
    image = bpy.data.images.load(path, check_existing=True)
    image.source = "SEQUENCE" if len(frames.numbers) > 1 else "FILE"
    image.reload()
    return image


def follow(user: bpy.types.ImageUser, frames: BakedFrames) -> None:
    """Have an editor show each frame of the scene with the file of its number."""
    first, last = frames.numbers[0], frames.numbers[-1]
    user.frame_start, user.frame_duration, user.frame_offset = first, last - first + 1, first - 1
    user.use_auto_refresh, user.use_cyclic = True, False

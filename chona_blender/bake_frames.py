"""Which frames a bake renders: from the scene's range, one's own, the selected markers, or the current frame."""

from __future__ import annotations

import bpy

from .errors import ChonaError

SCENE, CUSTOM, MARKERS, CURRENT = "SCENE", "CUSTOM", "MARKERS", "CURRENT"
RANGES = (
    (SCENE, "Scene", "The frame range and step of the scene, as its render has them"),
    (CUSTOM, "Custom", "A range and step of its own"),
    (
        MARKERS,
        "Selected Markers",
        "From the first to the last selected marker of the timeline; from a single one to the frame before the next",
    ),
    (CURRENT, "Current Frame", "The frame that the scene stands at"),
)


def frame_bounds(scene: bpy.types.Scene) -> tuple[int, int, int]:
    """First and last frame and step; the last is before the first where there are none."""
    settings = scene.chona
    if settings.frame_range == CUSTOM:
        return settings.frame_start, settings.frame_end, settings.frame_step
    if settings.frame_range == CURRENT:
        return scene.frame_current, scene.frame_current, 1
    if settings.frame_range == MARKERS:
        return _between_markers(scene)
    return scene.frame_start, scene.frame_end, scene.frame_step


def _between_markers(scene: bpy.types.Scene) -> tuple[int, int, int]:
    selected = sorted(marker.frame for marker in scene.timeline_markers if marker.select)
    if not selected:
        return 1, 0, 1
    first, last = selected[0], selected[-1]
    if first == last:
        later = [marker.frame for marker in scene.timeline_markers if marker.frame > first]
        last = min(later) - 1 if later else max(scene.frame_end, first)
    return first, last, scene.frame_step


def frames_of(scene: bpy.types.Scene) -> list[int]:
    """The frames to bake, increasing; empty when the range is."""
    first, last, step = frame_bounds(scene)
    return list(range(first, last + 1, step))


def checked_frames(scene: bpy.types.Scene) -> list[int]:
    """The frames to bake.

    Raises:
        ChonaError: there are none.
    """
    frames = frames_of(scene)
    if not frames and scene.chona.frame_range == MARKERS:
        raise ChonaError("no marker of the timeline is selected; select one or more, or choose another frame range")
    if not frames:
        first, last, _ = frame_bounds(scene)
        raise ChonaError(f"the frame range {first} to {last} is empty; set a last frame that is not before the first")
    return frames

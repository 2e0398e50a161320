"""The strip under the frame numbers of timeline and dope sheet: how far each frame is from the training poses.

Green is as in training, red far from it. Colours and corners are made once for each report; drawing only places them.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from . import check_store
from .areas import redraw_areas
from .rig.check import Report, Strip

GREEN, YELLOW, RED = (0.16, 0.62, 0.28), (0.93, 0.78, 0.15), (0.86, 0.16, 0.13)
_SCRUB_HEIGHT = 24.0
_STRIP_HEIGHT = 7.0
_handles: list[Any] = []
_made: dict[int, tuple[Report, list[tuple[list, list]]]] = {}


def colours(level: np.ndarray) -> np.ndarray:
    """[F, 4] colours of levels [F] from 0 (green) over a half (yellow) to 1 (red)."""
    ends = np.array([GREEN, YELLOW, RED])
    place = np.clip(level, 0.0, 1.0) * 2.0
    low = np.minimum(place.astype(int), 1)
    share = (place - low)[:, None]
    return np.concatenate([ends[low] * (1.0 - share) + ends[low + 1] * share, np.ones((len(level), 1))], axis=-1)


def corners(strip: Strip) -> tuple[list, list]:
    """Two triangles a frame, x in frames and y from 0 to 1, with a colour for every corner."""
    left, right = strip.frames - 0.5, strip.frames + 0.5
    low, high = np.zeros(len(left)), np.ones(len(left))
    points = [np.stack(pair, -1) for pair in (
        (left, low), (right, low), (right, high), (left, low), (right, high), (left, high))]  # fmt: skip
    flat = np.stack(points, axis=1).reshape(-1, 2)
    return flat.tolist(), np.repeat(colours(strip.level), 6, axis=0).tolist()


def _draw() -> None:
    context = bpy.context
    report, region = check_store.report_of(context.scene), context.region
    if report is None or region is None or not region.height:
        return
    import gpu
    from gpu_extras.batch import batch_for_shader

    known = _made.get(context.scene.session_uid)
    if known is None or known[0] is not report:
        known = (report, [corners(strip) for strip in report.strips if len(strip.frames)])
        _made[context.scene.session_uid] = known
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    scale = context.preferences.system.ui_scale
    origin = region.view2d.view_to_region(0.0, 0.0, clip=False)[0]
    width = (region.view2d.view_to_region(1000.0, 0.0, clip=False)[0] - origin) / 1000.0
    gpu.state.blend_set("ALPHA")
    for row, (points, paint) in enumerate(known[1]):
        top = region.height - (_SCRUB_HEIGHT + (_STRIP_HEIGHT + 1.0) * row) * scale
        with gpu.matrix.push_pop():
            gpu.matrix.translate((origin, top - _STRIP_HEIGHT * scale))
            gpu.matrix.scale((width, _STRIP_HEIGHT * scale))
            batch_for_shader(shader, "TRIS", {"pos": points, "color": paint}).draw(shader)
    gpu.state.blend_set("NONE")


def redraw() -> None:
    """Have timelines and dope sheets drawn again."""
    redraw_areas("DOPESHEET_EDITOR")


def register() -> None:
    """Draw in every timeline and dope sheet."""
    _handles.append(bpy.types.SpaceDopeSheetEditor.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL"))


def unregister() -> None:
    """Draw no more."""
    while _handles:
        bpy.types.SpaceDopeSheetEditor.draw_handler_remove(_handles.pop(), "WINDOW")
    _made.clear()

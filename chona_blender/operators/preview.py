"""Operators that switch the live preview on and off, and start its worker again."""

from __future__ import annotations

import bpy

from .. import live, live_kept, messages
from ..areas import redraw_areas
from ..errors import ChonaError
from ..readiness import why_not_ready
from .poll import allowed, needs


class CHONA_OT_live_preview(bpy.types.Operator):
    """Show the posed actor in views through the camera while you pose: a draft at once, a better picture at rest"""

    bl_idname = "chona.live_preview"
    bl_label = "Live Preview"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        on = live.preview.is_on_for(context.scene)  # off is always possible
        return allowed(cls, "" if on else why_not_ready(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        if live.preview.is_on_for(context.scene):
            live.switch_off()
        else:
            try:
                live.switch_on(context.scene)
            except ChonaError as error:
                return messages.fail(self, error)
        redraw_areas("VIEW_3D")
        return {"FINISHED"}


class CHONA_OT_live_restart(bpy.types.Operator):
    """Start the worker of the live preview once more, after it has ended by itself"""

    bl_idname = "chona.live_restart"
    bl_label = "Start Again"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        stopped = live.preview.is_on_for(context.scene) and live.preview.stopped
        return needs(cls, stopped, "The preview's worker is running, or the preview is off")

    def execute(self, context: bpy.types.Context) -> set[str]:
        live_kept.start_again()
        try:
            live.switch_on(context.scene)
        except ChonaError as error:
            return messages.fail(self, error)
        redraw_areas("VIEW_3D")
        return {"FINISHED"}


CLASSES = (CHONA_OT_live_preview, CHONA_OT_live_restart)

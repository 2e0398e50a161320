"""Operators that switch the live preview on and off, and start its worker again."""

from __future__ import annotations

import bpy

from .. import jobs, live, live_kept
from ..errors import ChonaError
from ..readiness import why_not_ready


class CHONA_OT_live_preview(bpy.types.Operator):
    """Show the posed actor in views through the camera while you pose: a draft at once, a better picture at rest"""

    bl_idname = "chona.live_preview"
    bl_label = "Live Preview"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        words = "" if live.preview.is_on_for(context.scene) else why_not_ready(context.scene)  # off is always possible
        if words:
            cls.poll_message_set(words)
        return not words

    def execute(self, context: bpy.types.Context) -> set[str]:
        if live.preview.is_on_for(context.scene):
            live.switch_off()
        else:
            try:
                live.switch_on(context.scene)
            except ChonaError as error:
                return jobs.fail(self, error)
        jobs.redraw_sidebars(context)
        return {"FINISHED"}


class CHONA_OT_live_restart(bpy.types.Operator):
    """Start the worker of the live preview once more, after it has ended by itself"""

    bl_idname = "chona.live_restart"
    bl_label = "Start Again"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not (live.preview.is_on_for(context.scene) and live.preview.stopped):
            cls.poll_message_set("The preview's worker is running, or the preview is off")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        live_kept.start_again()
        try:
            live.switch_on(context.scene)
        except ChonaError as error:
            return jobs.fail(self, error)
        jobs.redraw_sidebars(context)
        return {"FINISHED"}


CLASSES = (CHONA_OT_live_preview, CHONA_OT_live_restart)

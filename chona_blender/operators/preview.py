"""The operator that switches the live preview on and off."""

from __future__ import annotations

import bpy

from .. import jobs, live
from ..errors import ChonaError


class CHONA_OT_live_preview(bpy.types.Operator):
    """Show the posed actor in views through the camera while you pose: a draft at once, a better picture at rest"""

    bl_idname = "chona.live_preview"
    bl_label = "Live Preview"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        settings = context.scene.chona
        reasons = (
            (live.preview.is_on, ""),  # it can always be switched off
            (not settings.model_path, "Choose a model file first"),
            (
                settings.armature is None and not any(item.use for item in settings.objects),
                "Create a rig, or choose an armature, first",
            ),
            (context.scene.camera is None, "The scene has no camera: add one and make it active"),
        )
        words = next((words for applies, words in reasons if applies), "")
        if words:
            cls.poll_message_set(words)
        return not words

    def execute(self, context: bpy.types.Context) -> set[str]:
        if live.preview.is_on:
            live.preview.off()
        else:
            try:
                live.preview.on(context.scene)
            except ChonaError as error:
                return jobs.fail(self, error)
        jobs.redraw_sidebars(context)
        return {"FINISHED"}


CLASSES = (CHONA_OT_live_preview,)

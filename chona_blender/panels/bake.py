"""Frames to EXR files, and the live preview."""

from __future__ import annotations

import bpy

from .. import live
from ..frames import describe_frames
from ..live_view import camera_views
from .costs import draw_costs
from .sidebar import Sidebar, wrapped


class CHONA_PT_bake(Sidebar, bpy.types.Panel):
    """Frames to EXR files."""

    bl_idname = "CHONA_PT_bake"
    bl_label = "Bake"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        column = self.columns()
        column.prop(settings, "name")
        column.prop(settings, "output_folder")
        row = column.row(align=True)
        row.prop(settings, "preset")
        row.operator("chona.refresh_presets", text="", icon="FILE_REFRESH")
        draw_costs(column, context)
        column.prop(settings, "max_error")
        column.prop(settings, "use_scene_range")
        if not settings.use_scene_range:
            part = column.column(align=True)
            part.prop(settings, "frame_start")
            part.prop(settings, "frame_end")
            part.prop(settings, "frame_step")
        column.prop(settings, "overwrite")
        column.prop(settings, "composite_after")
        words = describe_frames(settings.frames())
        button = self.layout.row()
        button.scale_y = 1.4
        button.operator("chona.bake", text=f"Bake {words}", icon="RENDER_ANIMATION")
        self.draw_preview(context)
        if not bpy.data.filepath and settings.output_folder.startswith("//"):
            words = "The file was never saved: frames go to a temporary folder"
            wrapped(self.layout, words, icon="INFO", context=context)

    def draw_preview(self, context: bpy.types.Context) -> None:
        """The switch of the live preview, and why nothing is seen."""
        preview = live.preview
        row = self.layout.row(align=True)
        row.operator("chona.live_preview", icon="VIEW_CAMERA", depress=preview.is_on)
        if preview.is_on:
            row.prop(context.scene.chona, "live_opacity", text="", slider=True)
        if preview.error:
            wrapped(self.layout.box(), preview.error, icon="ERROR", context=context)
        elif preview.is_on and next(camera_views(context.scene), None) is None:
            wrapped(self.layout, "Look through the camera to see the preview (Numpad 0)", icon="INFO", context=context)


CLASSES = (CHONA_PT_bake,)

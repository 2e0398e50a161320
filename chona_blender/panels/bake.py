"""Frames to EXR files, and the live preview."""

from __future__ import annotations

import bpy

from .. import cost_table, frames_there, live
from ..bake_frames import CUSTOM
from ..frames import describe_frames
from ..live_view import camera_views
from ..output import Output, goes_to_temporary, output_now
from .costs import draw_costs
from .sidebar import Sidebar, wrapped


class CHONA_PT_bake(Sidebar, bpy.types.Panel):
    """Frames to EXR files."""

    bl_idname = "CHONA_PT_bake"
    bl_label = "Bake"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        output = output_now(context.scene)
        column = self.columns()
        column.prop(settings, "use_scene_output")
        if not settings.use_scene_output:
            column.prop(settings, "name")
            column.prop(settings, "output_folder")
        row = column.row(align=True)
        row.prop(settings, "preset")
        row.operator("chona.refresh_presets", text="", icon="FILE_REFRESH")
        draw_costs(column, context)
        column.prop(settings, "max_error")
        column.prop(settings, "frame_range")
        if settings.frame_range == CUSTOM:
            part = column.column(align=True)
            part.prop(settings, "frame_start")
            part.prop(settings, "frame_end")
            part.prop(settings, "frame_step")
        column.prop(settings, "existing")
        column.prop(settings, "composite_after")
        column.prop(settings, "detach")
        if output is not None and (settings.use_scene_output or goes_to_temporary(context.scene)):
            where = "Not saved yet, so into " if goes_to_temporary(context.scene) else "Into "
            wrapped(self.layout, f"{where}{output.folder}", icon="FILE_FOLDER", context=context)
        self.draw_buttons(context, output)
        self.draw_preview(context)

    def draw_buttons(self, context: bpy.types.Context, output: Output | None) -> None:
        """Bake, what it will take and what is there already, and what to do with frames."""
        frames = context.scene.chona.frames()
        column = self.layout.column(align=True)
        button = column.row(align=True)
        button.scale_y = 1.4
        words = describe_frames(frames)
        button.operator("chona.bake", text=f"Bake {words[:1].upper()}{words[1:]}", icon="RENDER_ANIMATION")
        button.operator("chona.bake", text="", icon="RENDER_STILL").current = True
        parts = (_there_words(frames, output), cost_table.time_of_bake(context.scene))
        if any(parts):
            column.label(text="   ".join(part for part in parts if part), icon="TIME")
        row = self.layout.row(align=True)
        row.operator("chona.show_frames", icon="IMAGE_DATA")
        row.operator("chona.open_output", text="Open Folder", icon="FILE_FOLDER")

    def draw_preview(self, context: bpy.types.Context) -> None:
        """The switch of the live preview, and why nothing is seen."""
        preview = live.preview
        self.layout.separator()
        row = self.layout.row(align=True)
        row.operator("chona.live_preview", icon="VIEW_CAMERA", depress=preview.is_on_for(context.scene))
        if preview.is_on_for(context.scene):
            row.prop(context.scene.chona, "live_opacity", text="", slider=True)
        if preview.error:
            box = self.layout.box()
            wrapped(box, preview.error, icon="ERROR", context=context)
            if preview.stopped:
                box.operator("chona.live_restart", icon="FILE_REFRESH")
        elif preview.is_on_for(context.scene) and next(camera_views(context.scene), None) is None:
            wrapped(self.layout, "Look through the camera to see the preview (Numpad 0)", icon="INFO", context=context)


def _there_words(frames: list[int], output: Output | None) -> str:
    known = None if output is None else frames_there.known(output)
    there = 0 if known is None else len(known.intersection(frames))
    return f"{there} of {len(frames)} frames are there" if there else ""


CLASSES = (CHONA_PT_bake,)

"""Captures from the scene."""

from __future__ import annotations

import bpy

from ..frames import describe_frames
from .sidebar import Sidebar


class CHONA_PT_capture(Sidebar, bpy.types.Panel):
    """Captures from a rigged character of the scene."""

    bl_idname = "CHONA_PT_capture"
    bl_label = "Capture"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        column = self.columns()
        column.prop(settings, "capture_armature")
        column.prop(settings, "capture_object")
        column.prop(settings, "capture_person")
        column.prop(settings, "capture_sequence")
        column.prop(settings, "capture_folder")
        column.prop(settings, "capture_cameras")
        part = column.column(align=True)
        part.prop(settings, "capture_width")
        part.prop(settings, "capture_height")
        column.prop(settings, "capture_samples")
        frames = settings.frames()
        images = 2 * len(frames) * settings.capture_cameras
        self.layout.label(text=f"{describe_frames(frames).capitalize()}: {images} renders", icon="INFO")
        self.layout.operator("chona.capture", icon="OUTLINER_OB_CAMERA")


CLASSES = (CHONA_PT_capture,)

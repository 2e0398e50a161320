"""Captures from the scene, and a model from captures."""

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


class CHONA_PT_train(Sidebar, bpy.types.Panel):
    """A model from captures."""

    bl_idname = "CHONA_PT_train"
    bl_label = "Train"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        column = self.columns()
        column.prop(settings, "data_folder")
        column.prop(settings, "data_format")
        column.prop(settings, "sequences")
        column.prop(settings, "run_folder")
        column.prop(settings, "train_preset")
        column.prop(settings, "minutes", text="Minutes")
        column.prop(settings, "resume")
        row = self.layout.row(align=True)
        row.operator("chona.train", icon="PLAY")
        row.operator("chona.use_trained", text="Use Result", icon="IMPORT")


CLASSES = (CHONA_PT_capture, CHONA_PT_train)

"""Captures from the scene."""

from __future__ import annotations

import bpy

from .. import capturing, jobs, ring_view
from ..bake_frames import CUSTOM
from ..capturing import CaptureJob
from ..frames import describe_frames
from .sidebar import Sidebar, wrapped


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
        part = column.column(align=True)
        part.prop(settings, "capture_range")
        if settings.capture_range == CUSTOM:
            for name in ("start", "end", "step"):
                part.prop(settings, f"capture_frame_{name}")
        part = column.column(align=True)
        part.prop(settings, "capture_width")
        part.prop(settings, "capture_height")
        column.prop(settings, "capture_samples")


class CHONA_PT_capture_cameras(Sidebar, bpy.types.Panel):
    """Where the cameras stand."""

    bl_idname = "CHONA_PT_capture_cameras"
    bl_label = "Cameras"
    bl_parent_id = "CHONA_PT_capture"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        column = self.columns()
        column.prop(settings, "capture_cameras")
        column.prop(settings, "capture_rings")
        row = column.row()
        row.active = settings.capture_rings > 1
        row.prop(settings, "capture_ring_spacing")
        column.prop(settings, "capture_radius")
        column.prop(settings, "capture_ring_height")
        column.prop(settings, "capture_stagger")
        column.prop(settings, "capture_lens")
        on = ring_view.is_on()
        icon = "HIDE_OFF" if on else "HIDE_ON"
        self.layout.operator(
            "chona.show_ring", text="Hide Cameras" if on else "Show Cameras", icon=icon, depress=on
        )  # fmt: skip
        words = ring_view.words(context.scene)
        if words:
            icon = "ERROR" if ring_view.problem(context.scene) else "INFO"
            wrapped(self.layout, words, icon=icon, context=context)


class CHONA_PT_capture_start(Sidebar, bpy.types.Panel):
    """What a capture takes, and its start."""

    bl_idname = "CHONA_PT_capture_start"
    bl_label = "Start"
    bl_parent_id = "CHONA_PT_capture"
    bl_options = {"HIDE_HEADER"}

    def draw(self, context: bpy.types.Context) -> None:
        settings, layout = context.scene.chona, self.layout
        frames = settings.capture_frames()
        images = len(frames) * settings.capture_ring().cameras
        text = f"{describe_frames(frames).capitalize()}: {images} images with masks"
        wrapped(layout, text, icon="INFO", context=context)
        words, stale = capturing.last_estimate(context.scene)
        if words:
            text = f"Estimated before settings changed: {words}" if stale else words
            wrapped(layout, text[:1].upper() + text[1:], icon="TIME", context=context)
        row = layout.row(align=True)
        row.operator("chona.estimate_capture", icon="TIME")
        row.operator("chona.capture", icon="OUTLINER_OB_CAMERA")
        job = jobs.running()
        if isinstance(job, CaptureJob):
            layout.progress(factor=job.share, text=job.text)
            layout.operator("chona.cancel", icon="X")


CLASSES = (CHONA_PT_capture, CHONA_PT_capture_cameras, CHONA_PT_capture_start)

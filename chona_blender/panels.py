"""The sidebar tab CHONA in the 3D view. Drawing reads the settings and what is cached; nothing is computed and no file
is opened.
"""

from __future__ import annotations

import bpy

from . import compositing, diagnosis, jobs, live, model_cache, preferences
from .frames import describe_frames
from .live_view import camera_views


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "CHONA"

    layout: bpy.types.UILayout

    def columns(self) -> bpy.types.UILayout:
        """A column with labels on the left, as in Blender's own panels."""
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        return self.layout.column()


class CHONA_PT_main(_Sidebar, bpy.types.Panel):
    """The running job, the last error, and the model."""

    bl_idname = "CHONA_PT_main"
    bl_label = "Model"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        draw_job(self.layout)
        draw_error(self.layout)
        column = self.columns()
        column.prop(settings, "model_path")
        header = model_cache.cached(settings.model_path)
        if header is not None:
            persons, objects = ", ".join(header.persons) or "nobody", ", ".join(header.objects) or "none"
            box = self.layout.box().column(align=True)
            box.label(text=f"People: {persons}", icon="ARMATURE_DATA")
            box.label(text=f"Objects: {objects}", icon="EMPTY_AXIS")
            box.label(text=f"{len(header.names)} bones, method {header.method or 'unknown'}", icon="INFO")
        elif settings.model_path:
            words = model_cache.cached_error(settings.model_path)
            if words:
                wrapped(self.layout.box(), words[:1].upper() + words[1:], icon="ERROR", context=context)
        else:
            wrapped(self.layout, "Choose a model file, or train one below", icon="INFO", context=context)


class CHONA_UL_objects(bpy.types.UIList):
    """Objects of the actor with what moves each."""

    def draw_item(
        self,
        _context: bpy.types.Context,
        layout: bpy.types.UILayout,
        _data: object,
        item: bpy.types.PropertyGroup,
        _icon: int,
        _active_data: object,
        _active_property: str,
    ) -> None:
        row = layout.row(align=True)
        row.prop(item, "use", text="")
        parts = row.split(factor=0.45, align=True)
        parts.prop(item, "name", text="", emboss=False)
        part = parts.row(align=True)
        part.alert = item.use and item.empty is None
        part.prop(item, "empty", text="")


class CHONA_PT_rig(_Sidebar, bpy.types.Panel):
    """Who is rendered and what poses them."""

    bl_idname = "CHONA_PT_rig"
    bl_label = "Rig"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        column = self.columns()
        column.prop(settings, "person", icon="USER")
        column.prop(settings, "armature", icon="ARMATURE_DATA")
        self.layout.use_property_split = False  # a list's rows have no labels on the left
        self.layout.label(text="Objects and what moves them:")
        row = self.layout.row()
        row.template_list("CHONA_UL_objects", "", settings, "objects", settings, "active_object", rows=2)
        buttons = row.column(align=True)
        buttons.operator("chona.object_add", text="", icon="ADD")
        buttons.operator("chona.object_remove", text="", icon="REMOVE")
        self.layout.operator("chona.create_rig", icon="OUTLINER_OB_ARMATURE")


class CHONA_PT_bake(_Sidebar, bpy.types.Panel):
    """Frames to EXR files."""

    bl_idname = "CHONA_PT_bake"
    bl_label = "Bake"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        column = self.columns()
        column.prop(settings, "name")
        column.prop(settings, "output_folder")
        column.prop(settings, "preset")
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


class CHONA_PT_composite(_Sidebar, bpy.types.Panel):
    """Baked frames in the scene's compositor."""

    bl_idname = "CHONA_PT_composite"
    bl_label = "Composite"

    def draw(self, context: bpy.types.Context) -> None:
        row = self.layout.row(align=True)
        present = compositing.has_layers(context.scene)
        row.operator("chona.composite", text="Update" if present else "Composite", icon="NODE_COMPOSITING")
        row.operator("chona.composite_remove", text="Remove", icon="X")
        if present:
            for name in compositing.layer_names(context.scene):
                self.layout.label(text=compositing.layer_group_name(name), icon="NODETREE")
        self.layout.operator("chona.open_output", icon="FILE_FOLDER")


class CHONA_PT_capture(_Sidebar, bpy.types.Panel):
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


class CHONA_PT_train(_Sidebar, bpy.types.Panel):
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


class CHONA_PT_worker(_Sidebar, bpy.types.Panel):
    """The Python that renders and trains."""

    bl_idname = "CHONA_PT_worker"
    bl_label = "Worker"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        found = preferences.preferences()
        column = self.columns()
        if found is not None:
            column.prop(found, "worker_python")
            column.prop(found, "device")
        draw_worker(self.layout, context)


def draw_worker(layout: bpy.types.UILayout, context: bpy.types.Context | None = None) -> None:
    """The result of the last check and the buttons for it."""
    report = diagnosis.worker_report
    if report is not None:
        box = layout.box()
        icon = "CHECKMARK" if report.good else "ERROR"
        wrapped(box, report.summary[:1].upper() + report.summary[1:], icon=icon, context=context)
    row = layout.row(align=True)
    row.operator("chona.check_worker", icon="VIEWZOOM")
    row.operator("chona.copy_report", icon="COPYDOWN")


def draw_job(layout: bpy.types.UILayout) -> None:
    """The running job: a bar, words, and Cancel."""
    job = jobs.running()
    if job is None:
        return
    box = layout.box().column()
    box.label(text=job.title, icon="SORTTIME")
    box.progress(factor=job.share, text=f"{100.0 * job.share:.0f} %")
    box.label(text=job.text)
    box.operator("chona.cancel", icon="CANCEL")


def draw_error(layout: bpy.types.UILayout) -> None:
    """The last failure in full, to be read at leisure and copied."""
    words = jobs.last_error()
    if not words:
        return
    box = layout.box()
    wrapped(box, words, icon="ERROR", context=bpy.context)
    row = box.row(align=True)
    row.operator("chona.copy_report", icon="COPYDOWN")
    row.operator("chona.dismiss_error", icon="X")


def wrapped(layout: bpy.types.UILayout, text: str, icon: str, context: bpy.types.Context | None) -> None:
    """A text over as many lines as the panel's width needs; labels do not wrap by themselves."""
    width = 320.0 if context is None or context.region is None else float(context.region.width)
    scale = bpy.context.preferences.system.ui_scale
    most = max(int((width / scale - 70.0) / 6.0), 16)
    lines, line = [], ""
    for word in text.split():
        part = word
        while len(part) > most:  # paths have no spaces
            if line:
                lines.append(line)
            lines.append(part[:most])
            part, line = part[most:], ""
        if len(line) + len(part) + 1 > most and line:
            lines.append(line)
            line = part
        else:
            line = f"{line} {part}".strip()
    if line:
        lines.append(line)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for index, each in enumerate(lines):
        column.label(text=each, icon=icon if index == 0 else "BLANK1")


CLASSES = (
    CHONA_UL_objects,
    CHONA_PT_main,
    CHONA_PT_rig,
    CHONA_PT_bake,
    CHONA_PT_composite,
    CHONA_PT_capture,
    CHONA_PT_train,
    CHONA_PT_worker,
)

"""The first panel: the running job, the last error, and the model."""

from __future__ import annotations

import bpy

from .. import jobs, model_cache
from .sidebar import Sidebar, wrapped


class CHONA_PT_main(Sidebar, bpy.types.Panel):
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


CLASSES = (CHONA_PT_main,)

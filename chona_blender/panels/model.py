"""The first panel: the running job, the last error, the actors and the selected one's model."""

from __future__ import annotations

import bpy

from .. import jobs, messages, model_cache
from .sidebar import Sidebar, wrapped


class CHONA_UL_actors(bpy.types.UIList):
    """Actors of the scene."""

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
        parts = row.split(factor=0.55, align=True)
        parts.prop(item, "name", text="", emboss=False, placeholder=item.label, icon="USER")
        armature = item.armature
        parts.label(text=armature.name if armature is not None else "", icon="ARMATURE_DATA" if armature else "BLANK1")


class CHONA_PT_main(Sidebar, bpy.types.Panel):
    """The running job, the last error, the actors and the selected one's model."""

    bl_idname = "CHONA_PT_main"
    bl_label = "Model"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        actor = settings.actor
        draw_job(self.layout)
        draw_error(self.layout)
        draw_news(self.layout)
        if len(settings.actors) > 1:
            row = self.layout.row()
            row.template_list("CHONA_UL_actors", "", settings, "actors", settings, "active_actor", rows=3)
            buttons = row.column(align=True)
            buttons.operator("chona.actor_add", text="", icon="ADD")
            buttons.operator("chona.actor_remove", text="", icon="REMOVE")
        row = self.columns().row(align=True)
        row.prop(actor if actor is not None else settings, "model_path" if actor is not None else "first_model")
        if len(settings.actors) == 1:
            row.operator("chona.actor_add", text="", icon="COMMUNITY")
        if actor is not None:
            self.draw_model(context, actor.model_path)
        else:
            wrapped(self.layout, "Choose a model file, or train one below", icon="INFO", context=context)

    def draw_model(self, context: bpy.types.Context, path: str) -> None:
        """What the model holds, or why it cannot be read."""
        model_cache.watch(path)
        header = model_cache.cached(path)
        if header is not None:
            persons, objects = ", ".join(header.persons) or "nobody", ", ".join(header.objects) or "none"
            box = self.layout.box().column(align=True)
            box.label(text=f"People: {persons}", icon="ARMATURE_DATA")
            box.label(text=f"Objects: {objects}", icon="EMPTY_AXIS")
            box.label(text=f"{len(header.names)} bones, method {header.method or 'unknown'}", icon="INFO")
        elif path:
            words = model_cache.cached_error(path)
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
    if job.worker.goes_on:
        box.label(text="Keeps running without Blender", icon="UNLINKED")
    box.operator("chona.cancel", icon="CANCEL")


def draw_error(layout: bpy.types.UILayout) -> None:
    """The last failure in full, to be read at leisure and copied."""
    words = messages.last_error()
    if not words:
        return
    box = layout.box()
    wrapped(box, words, icon="ERROR", context=bpy.context)
    row = box.row(align=True)
    row.operator("chona.copy_report", icon="COPYDOWN")
    row.operator("chona.dismiss_error", icon="X")


def draw_news(layout: bpy.types.UILayout) -> None:
    """What became of jobs that went on while Blender was closed."""
    told = messages.news()
    if told:
        box = layout.box()
        for words in told:
            wrapped(box, words, icon="INFO", context=bpy.context)
        box.operator("chona.dismiss_news", icon="X")


CLASSES = (CHONA_UL_actors, CHONA_PT_main)

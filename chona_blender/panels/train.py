"""A model from captures: what the data hold, trainings one after the other, and how the one that runs goes."""

from __future__ import annotations

import bpy

from .. import jobs, pictures, train_data, train_rows
from ..train_job import TrainJob
from ..train_properties import SCANS
from ..train_rows import CHONA_PG_training
from ..train_view import PICTURE
from .sidebar import Sidebar, wrapped

SHEET_LINES = 6
"""Warnings shown at once; ``chona check-data`` prints all."""


def draw_picture(layout: bpy.types.UILayout, name: str, context: bpy.types.Context) -> None:
    """A picture as wide as the panel; nothing where there is none."""
    shown = pictures.icon(name)
    if shown:
        unit = 20.0 * context.preferences.system.ui_scale
        layout.template_icon(icon_value=shown, scale=max(4.0, (context.region.width - 2.6 * unit) / unit))


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
        self._draw_headline(context)
        column = self.columns()
        column.prop(settings, "sequences")
        if settings.data_format in SCANS:
            column.prop(settings, "object_size")
        column.prop(settings, "base_model")
        if settings.base_model:
            column.prop(settings, "identities")
        column.prop(settings, "run_folder")
        row = column.row()
        row.active = not settings.base_model
        row.prop(settings, "train_preset")
        part = column.column(align=True)
        row = part.row()
        row.active = settings.train_steps == 0
        row.prop(settings, "minutes", text="Minutes")
        part.prop(settings, "train_steps")
        column.prop(settings, "preview_every")
        column.prop(settings, "resume")
        column.prop(settings, "detach")
        words = "Add to Queue" if jobs.running() is not None else "Train"
        self.layout.operator("chona.train", text=words, icon="PLAY")

    def _draw_headline(self, context: bpy.types.Context) -> None:
        scene = context.scene
        found = train_data.found(scene)
        if train_data.looking(scene):
            self.layout.label(text="Looking into the folder …", icon="TIME")
        elif found is not None and found.problem:
            wrapped(self.layout, found.problem, icon="ERROR", context=context)
        elif found is not None:
            wrapped(self.layout, found.headline, icon="INFO", context=context)
        self.layout.operator("chona.check_data", icon="VIEWZOOM")


class CHONA_PT_train_data(Sidebar, bpy.types.Panel):
    """What Check Data has found, with pictures."""

    bl_idname = "CHONA_PT_train_data"
    bl_label = "Data"
    bl_parent_id = "CHONA_PT_train"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        found = train_data.found(context.scene)
        return found is not None and found.checked

    def draw(self, context: bpy.types.Context) -> None:
        found, shown = train_data.found(context.scene), train_data.shown_sheet(context.scene)
        if found is None:
            return
        if shown is not None:
            self._draw_sheet(context, *shown)
        for words in found.warnings[:SHEET_LINES]:
            wrapped(self.layout, words, icon="ERROR", context=context)
        if len(found.warnings) > SHEET_LINES:
            self.layout.label(text=f"and {len(found.warnings) - SHEET_LINES} more", icon="BLANK1")
        if not found.warnings:
            self.layout.label(text="The data look right", icon="CHECKMARK")

    def _draw_sheet(self, context: bpy.types.Context, index: int, checked: train_data.Checked) -> None:
        layout, number = self.layout, len(train_data.sheets(train_data.key_of(context.scene)))
        row = layout.row(align=True)
        row.operator("chona.next_sheet", text="", icon="TRIA_LEFT").by = -1
        row.label(text=f"{checked.name} ({index + 1} of {number})")
        row.operator("chona.open_sheet", text="", icon="FULLSCREEN_ENTER")
        row.operator("chona.next_sheet", text="", icon="TRIA_RIGHT").by = 1
        draw_picture(layout, train_data.PICTURE, context)
        shares = (("joints", checked.joints_inside), ("objects", checked.objects_inside))
        words = [f"{share:.0%} of the {what}" for what, share in shares if share is not None]
        if words:
            wrapped(layout, f"{' and '.join(words)} inside the masks", icon="BLANK1", context=context)


class CHONA_UL_trainings(bpy.types.UIList):
    """Trainings: how each is, its name, and how far it is."""

    bl_idname = "CHONA_UL_trainings"

    def draw_item(
        self, _context: bpy.types.Context, layout: bpy.types.UILayout, _data: object, item: CHONA_PG_training,
        _icon: int, _active_data: object, _active_property: str, _index: int = 0,
    ) -> None:  # fmt: skip
        """One row."""
        label, icon = next((label, icon) for name, label, _, icon, _ in train_rows.STATES if name == item.state)
        split = layout.split(factor=0.6)
        split.label(text=item.name, icon=icon)
        busy = item.state in {train_rows.RUNNING, train_rows.PAUSED}
        split.label(text=f"{item.share:.0%}" if busy else label)


class CHONA_PT_trainings(Sidebar, bpy.types.Panel):
    """Trainings one after the other."""

    bl_idname = "CHONA_PT_trainings"
    bl_label = "Trainings"
    bl_parent_id = "CHONA_PT_train"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return bool(train_rows.rows())

    def draw(self, context: bpy.types.Context) -> None:
        layout, shown = self.layout, train_rows.trainings()
        row = layout.row()
        row.template_list(CHONA_UL_trainings.bl_idname, "", shown, "rows", shown, "active", rows=3)
        side = row.column(align=True)
        side.operator("chona.remove_training", text="", icon="REMOVE")
        side.separator()
        side.operator("chona.move_training", text="", icon="TRIA_UP").by = -1
        side.operator("chona.move_training", text="", icon="TRIA_DOWN").by = 1
        chosen, job = train_rows.selected(), jobs.running()
        row = layout.row(align=True)
        if chosen is not None and chosen.state == train_rows.RUNNING:
            row.operator("chona.pause_training", icon="PAUSE")
        else:
            waits = chosen is not None and chosen.state == train_rows.WAITING
            row.operator("chona.resume_training", text="Start" if waits else "Resume", icon="PLAY")
        row.operator("chona.cancel_training", icon="X")
        row.operator("chona.use_trained", icon="IMPORT")
        if isinstance(job, TrainJob):
            layout.progress(factor=job.share, text=job.text)
        if chosen is not None and chosen.words and chosen.state != train_rows.RUNNING:
            icon = "ERROR" if chosen.state == train_rows.FAILED else "INFO"
            wrapped(layout, chosen.words, icon=icon, context=context)
        draw_picture(layout, PICTURE, context)
        if pictures.icon(PICTURE):
            wrapped(layout, "Truth and model; the white curve is this view's PSNR", icon="INFO", context=context)


CLASSES = (CHONA_UL_trainings, CHONA_PT_train, CHONA_PT_train_data, CHONA_PT_trainings)

"""What every preset costs and gives, and the measuring of that."""

from __future__ import annotations

import bpy

from .. import cost_table, model_cache
from .sidebar import Sidebar, wrapped


def draw_costs(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """A row for every preset, whose name chooses it; whose times they are; and Estimate."""
    settings, table = context.scene.chona, cost_table.table(context.scene)
    box = layout.box().column(align=True)
    box.use_property_split = False
    if table.rows:
        for cell, text in zip(_cells(box), ("Preset", "Quality", "Frame", "Bake"), strict=True):
            cell.label(text=text)
        rows = box.column(align=True)
        rows.active = not table.stale
        for row in table.rows:
            name, *cells = _cells(rows)
            name.prop_enum(settings, "preset", row.name)
            for cell, text in zip(cells, (row.quality, row.frame, row.total), strict=True):
                cell.label(text=text)
    if table.note:
        wrapped(box, table.note, icon="ERROR" if table.stale else "INFO", context=context)
    if table.rows and settings.max_error > 0.0:
        wrapped(box, "With Max Error frames take longer than this", icon="INFO", context=context)
    if table.problem:
        wrapped(box, table.problem, icon="INFO", context=context)
    box.operator("chona.estimate", icon="SORTTIME")


def _cells(layout: bpy.types.UILayout) -> tuple[bpy.types.UILayout, ...]:
    """Four cells of a row: the name's, and those of quality and times, which stand on the right."""
    split = layout.split(factor=0.245, align=True)
    cells, rest = [split.row(align=True)], split.row(align=True)
    for factor in (0.318, 0.369, 1.0):
        rest = rest.split(factor=factor, align=True)
        cell = rest.row(align=True)
        cell.alignment = "RIGHT"
        cells.append(cell)
    return tuple(cells)


class CHONA_PT_speed(Sidebar, bpy.types.Panel):
    """What was measured of the model, and measuring it."""

    bl_idname = "CHONA_PT_speed"
    bl_label = "Speed and Quality"
    bl_parent_id = "CHONA_PT_bake"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        header = model_cache.cached(settings.model_path)
        if header is not None and header.trade is not None:
            words = f"Measured on {header.trade.get('views', 'some')} views"
            wrapped(self.layout, words, icon="CHECKMARK", context=context)
        column = self.columns()
        column.prop(settings, "data_folder")
        column.prop(settings, "data_format")
        column.prop(settings, "measure_sequences")
        column.prop(settings, "measure_minutes", text="Minutes")
        row = self.layout.row(align=True)
        row.operator("chona.trade", icon="DRIVER_DISTANCE")
        row.operator("chona.show_trade", icon="IMAGE_DATA")


CLASSES = (CHONA_PT_speed,)

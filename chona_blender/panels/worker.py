"""The Python that renders and trains."""

from __future__ import annotations

import bpy

from .. import diagnosis, preferences
from .sidebar import Sidebar, wrapped


class CHONA_PT_worker(Sidebar, bpy.types.Panel):
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


CLASSES = (CHONA_PT_worker,)

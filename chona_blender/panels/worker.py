"""The Python that renders and trains: which one, whether it works, and setting one up."""

from __future__ import annotations

import bpy

from .. import diagnosis, jobs, preferences, worker_setup
from ..i18n import report_text
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


class CHONA_PT_worker_setup(Sidebar, bpy.types.Panel):
    """The environment that the add-on makes for its worker."""

    bl_idname = "CHONA_PT_worker_setup"
    bl_label = "Environment"
    bl_parent_id = "CHONA_PT_worker"

    def draw(self, context: bpy.types.Context) -> None:
        draw_setup(self.columns(), context, preferences.preferences())


def draw_worker(layout: bpy.types.UILayout, context: bpy.types.Context | None = None) -> None:
    """The result of the last check and the buttons for it."""
    report = diagnosis.worker_report
    if report is not None:
        box = layout.box()
        icon = "CHECKMARK" if report.good else "ERROR"
        wrapped(box, report.summary[:1].upper() + report.summary[1:], icon=icon, context=context)
        for words in report.notes:
            wrapped(box, words, icon="INFO", context=context)
    row = layout.row(align=True)
    row.operator("chona.check_worker", icon="VIEWZOOM")
    row.operator("chona.copy_report", icon="COPYDOWN")


def draw_setup(
    layout: bpy.types.UILayout,
    context: bpy.types.Context | None,
    settings: preferences.CHONA_AP_preferences | None,
) -> None:
    """What is set up, what a set-up would take, and how far a running one is."""
    ready = worker_setup.known()
    if ready is not None:
        text = report_text(
            "Set up with torch {torch}, {size}", torch=ready.torch, size=worker_setup.size_words(ready.bytes)
        )
        wrapped(layout, text, icon="CHECKMARK", context=context)
    if settings is not None:
        column = layout.column()
        column.prop(settings, "setup_build")
        column.prop(settings, "setup_python")
        column.prop(settings, "setup_wheels")
        if not settings.setup_wheels and not bpy.app.online_access:
            box = layout.box()
            wrapped(box, worker_setup.offline_words(), icon="INTERNET_OFFLINE", context=context)
            if not bpy.app.online_access_override:
                box.operator("chona.open_network_preferences", icon="PREFERENCES")
    job = jobs.running()
    if isinstance(job, worker_setup.SetUpJob):
        layout.progress(factor=job.share, text=job.text)
    row = layout.row(align=True)
    row.operator("chona.set_up_worker", icon="IMPORT")
    row.operator("chona.remove_worker", icon="TRASH", text="Remove")


CLASSES = (CHONA_PT_worker, CHONA_PT_worker_setup)

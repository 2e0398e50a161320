"""What the last Check found."""

from __future__ import annotations

import bpy

from .. import check_store
from ..rig.findings import ERROR, INFO, WARNING
from .sidebar import Sidebar, wrapped

_ICONS = {ERROR: "CANCEL", WARNING: "ERROR", INFO: "INFO"}


def without_namespace(name: str) -> str:
    """`mixamorig:LeftArm` -> `LeftArm`: rows are narrow, and namespaces are the same in all of them."""
    return name.rpartition(":")[2]


class CHONA_UL_findings(bpy.types.UIList):
    """What is wrong, each with a button that goes there."""

    def draw_item(
        self,
        _context: bpy.types.Context,
        layout: bpy.types.UILayout,
        _data: object,
        item: bpy.types.PropertyGroup,
        _icon: int,
        _active_data: object,
        _active_property: str,
        index: int = 0,
    ) -> None:
        row = layout.row(align=True)
        parts = row.split(factor=0.52, align=True)
        parts.label(text=without_namespace(item.title), icon=_ICONS.get(item.kind, "INFO"))
        parts.label(text=item.short)
        row.operator("chona.show_finding", text="", icon="RESTRICT_SELECT_OFF").index = index


class CHONA_PT_check(Sidebar, bpy.types.Panel):
    """What is wrong with the actors, before rendering."""

    bl_idname = "CHONA_PT_check"
    bl_label = "Check"

    def draw(self, context: bpy.types.Context) -> None:
        scene = context.scene
        self.layout.operator("chona.check", icon="VIEWZOOM")
        report = check_store.report_of(scene)
        shown = context.window_manager.chona_findings
        if report is None:
            return
        first, last = report.frames
        if not report.findings:
            self.layout.label(text=f"Nothing is wrong in frames {first}–{last}", icon="CHECKMARK")
        elif shown.scene == scene.name:
            rows = min(max(len(report.findings), 3), 7)
            self.layout.template_list("CHONA_UL_findings", "", shown, "rows", shown, "active", rows=rows)
            if 0 <= shown.active < len(report.findings):
                finding = report.findings[shown.active]
                several = len(report.strips) > 1 and finding.actor
                words = f"{finding.actor}: {finding.words}" if several else finding.words
                box = self.layout.box()
                wrapped(box, words, icon=_ICONS[finding.kind], context=context)
                where = without_namespace(finding.bone or finding.item)
                text = f"Select {where}" if where else "Select"
                text += f", Frame {finding.frame}" if finding.frame is not None else ""
                box.operator("chona.show_finding", text=text, icon="RESTRICT_SELECT_OFF").index = shown.active
        for strip in report.strips:
            far = bool(len(strip.level)) and bool(strip.level.max() > 0.0)
            icon = "QUESTION" if not len(strip.frames) else "ERROR" if far else "CHECKMARK"
            wrapped(self.layout, f"{strip.actor}: {strip.words}", icon=icon, context=context)
        if any(len(strip.frames) for strip in report.strips):
            words = "Strip in the timeline: green as in training, red far from it"
            wrapped(self.layout, words, icon="COLOR", context=context)


CLASSES = (CHONA_UL_findings, CHONA_PT_check)

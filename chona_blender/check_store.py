"""What the last Check of each scene found, for its list and its strip; kept in memory, never in the file."""

from __future__ import annotations

import bpy

from .rig.check import Report
from .rig.findings import Finding

_reports: dict[int, Report] = {}


class CHONA_PG_finding(bpy.types.PropertyGroup):
    """A row of the list of findings; the finding itself has the same place in the report."""

    name: bpy.props.StringProperty(name="Finding", description="What is wrong, where and when")  # type: ignore[valid-type]
    title: bpy.props.StringProperty(name="About", description="The bone or object that is wrong")  # type: ignore[valid-type]
    short: bpy.props.StringProperty(name="In Short", description="What is wrong in two or three words")  # type: ignore[valid-type]
    kind: bpy.props.StringProperty(name="Kind", description="ERROR, WARNING or INFO")  # type: ignore[valid-type]


class CHONA_PG_findings(bpy.types.PropertyGroup):
    """The list of findings of the scene that was checked last."""

    rows: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=CHONA_PG_finding, name="Findings", description="What the last Check found, the worst first"
    )
    active: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Finding", description="The selected row of the list of findings", options={"HIDDEN"}
    )
    scene: bpy.props.StringProperty(name="Scene", description="Scene that was checked")  # type: ignore[valid-type]


def keep(scene: bpy.types.Scene, report: Report) -> None:
    """Show a report in the list and in the strips."""
    present = {each.session_uid for each in bpy.data.scenes}
    for gone in set(_reports) - present:
        del _reports[gone]
    _reports[scene.session_uid] = report
    shown = bpy.context.window_manager.chona_findings
    shown.rows.clear()
    shown.scene, shown.active = scene.name, 0
    for finding in report.findings:
        row = shown.rows.add()
        row.name, row.kind = finding.words, finding.kind
        row.title, row.short = finding.title, finding.short or finding.words


def report_of(scene: bpy.types.Scene) -> Report | None:
    """The scene's last report; None where it was not checked."""
    return _reports.get(scene.session_uid)


def finding_at(scene: bpy.types.Scene, index: int) -> Finding | None:
    """One finding of the scene's last report."""
    report = report_of(scene)
    return report.findings[index] if report is not None and 0 <= index < len(report.findings) else None


def register() -> None:
    """Give the window manager its list. A file that is loaded brings scenes of other numbers, so no report fits it."""
    bpy.types.WindowManager.chona_findings = bpy.props.PointerProperty(type=CHONA_PG_findings)


def unregister() -> None:
    """Take it away, and forget."""
    _reports.clear()
    del bpy.types.WindowManager.chona_findings


CLASSES = (CHONA_PG_finding, CHONA_PG_findings)

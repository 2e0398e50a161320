"""Operators that look for what is wrong with the actors, and take the user there."""

from __future__ import annotations

import bpy

from .. import check_store, messages
from ..checking import run_check
from ..errors import ChonaError
from ..rig.findings import ERROR, WARNING, Finding
from .poll import needs


class CHONA_OT_check(bpy.types.Operator):
    """Look for what is wrong with the actors over the bake's frames: unmapped, scaled, sheared, outside the training"""

    bl_idname = "chona.check"
    bl_label = "Check"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.scene.chona.used_actors(), "Choose a model file and an armature first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            report = run_check(context.scene)
        except ChonaError as error:
            return messages.fail(self, error)
        counts = {kind: sum(each.kind == kind for each in report.findings) for kind in (ERROR, WARNING)}
        if counts[ERROR]:
            self.report({"WARNING"}, f"{counts[ERROR]} errors and {counts[WARNING]} warnings; see Check in the sidebar")
        elif counts[WARNING]:
            self.report({"INFO"}, f"{counts[WARNING]} warnings, no errors; see Check in the sidebar")
        else:
            self.report({"INFO"}, "Nothing is wrong")
        return {"FINISHED"}


class CHONA_OT_show_finding(bpy.types.Operator):
    """Go to the finding's worst frame and select its bone or object"""

    bl_idname = "chona.show_finding"
    bl_label = "Select"
    bl_options = {"REGISTER", "UNDO"}

    index: bpy.props.IntProperty(name="Finding", description="Row of the list; -1 takes the selected one", default=-1)  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, check_store.report_of(context.scene), "Press Check first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        shown = context.window_manager.chona_findings
        index = shown.active if self.index < 0 else self.index
        finding = check_store.finding_at(context.scene, index)
        if finding is None:
            return messages.fail(self, ChonaError("there is no such finding any more; press Check again"))
        shown.active = index
        try:
            self.report({"INFO"}, show(context, finding))
        except ChonaError as error:
            return messages.fail(self, error)
        return {"FINISHED"}


def show(context: bpy.types.Context, finding: Finding) -> str:
    """Select what a finding is about, in its frame. Returns words for a report.

    Raises:
        ChonaError: it is not in the view layer any more.
    """
    scene, layer = context.scene, context.view_layer
    if finding.frame is not None and scene.frame_current != finding.frame:
        scene.frame_set(finding.frame)
    _show_row(scene, finding)
    if not finding.item:
        return finding.words
    item = scene.objects.get(finding.item)
    if item is None or item.name not in layer.objects:
        raise ChonaError(f"'{finding.item}' is not in the view layer any more; press Check again")
    if layer.objects.active is not None and layer.objects.active.mode != "OBJECT" and layer.objects.active != item:
        bpy.ops.object.mode_set(mode="OBJECT")
    if item.mode == "OBJECT":
        for each in layer.objects:
            each.select_set(each == item)
    layer.objects.active = item
    bone = item.data.bones.get(finding.bone) if item.type == "ARMATURE" and finding.bone else None
    if bone is None:
        return f"Selected '{item.name}'"
    if item.mode != "POSE":
        bpy.ops.object.mode_set(mode="POSE")
    for each in item.pose.bones:
        owner = each if hasattr(each, "select") else each.bone  # before 5.0 selection belonged to the bone
        owner.select = each.name == bone.name
    bone.hide = False
    item.data.bones.active = bone
    return f"Selected '{bone.name}'"


def _show_row(scene: bpy.types.Scene, finding: Finding) -> None:
    """The finding's row in the table of bones of its actor."""
    settings = scene.chona
    for number, actor in enumerate(settings.actors):
        if actor.armature is not None and actor.armature.name == finding.item:
            row = next((index for index, item in enumerate(actor.bones) if item.name == finding.model_bone), None)
            if row is not None:
                settings.active_actor, actor.active_bone = number, row


CLASSES = (CHONA_OT_check, CHONA_OT_show_finding)

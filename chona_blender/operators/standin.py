"""Meshes that stand in for the selected actor."""

from __future__ import annotations

import bpy

from .. import jobs, standin
from ..job_operator import JobOperator
from ..readiness import NO_MODEL
from .poll import allowed, needs


def why_no_stand_in(context: bpy.types.Context) -> str:
    """Why a stand-in cannot be made at present, or nothing."""
    settings = context.scene.chona
    actor = settings.actor
    if jobs.busy():
        return jobs.busy()
    if actor is None or not actor.model_path:
        return NO_MODEL
    if actor.armature is None and not any(item.use for item in actor.objects):
        return "Create a rig, or choose an armature, first"
    if any(item.mode == "EDIT" for item in standin.stand_ins(actor)):
        return "Leave the stand-in's Edit Mode first"
    return ""


class CHONA_OT_stand_in_make(JobOperator, bpy.types.Operator):
    """Make meshes of the selected actor's person and objects that follow its rig in real time, or renew them"""

    bl_idname = "chona.stand_in_make"
    bl_label = "Make Stand-In"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return allowed(cls, why_no_stand_in(context))

    def start(self, context: bpy.types.Context) -> jobs.Job:
        return standin.start_stand_in(context.scene, context.scene.chona.actor)

    def finish(self, context: bpy.types.Context, job: jobs.Job) -> str:
        made = standin.finish_stand_in(job)
        triangles = sum(len(item.data.polygons) for item in made)
        words = f"Made {', '.join(item.name for item in made)}: {triangles:,} triangles"
        return words + (", shown in colour" if show_colours(context) else "")


class CHONA_OT_stand_in_remove(bpy.types.Operator):
    """Remove the selected actor's stand-in with its meshes and materials"""

    bl_idname = "chona.stand_in_remove"
    bl_label = "Remove Stand-In"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        actor = context.scene.chona.actor
        return needs(cls, actor is not None and actor.stand_in.parts, "The selected actor has no stand-in")

    def execute(self, context: bpy.types.Context) -> set[str]:
        standin.remove_stand_in(context.scene.chona.actor)
        return {"FINISHED"}


def show_colours(context: bpy.types.Context) -> bool:
    """Has the 3D view of the button show vertex colours, where it is in Solid mode as Blender starts."""
    space = context.space_data
    if space is None or space.type != "VIEW_3D":
        return False
    shading = space.shading
    if shading.type != "SOLID" or shading.color_type != "MATERIAL":
        return False
    shading.color_type = "VERTEX"
    return True


CLASSES = (CHONA_OT_stand_in_make, CHONA_OT_stand_in_remove)

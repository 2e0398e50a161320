"""Operators for the rig and the list of objects."""

from __future__ import annotations

import bpy

from .. import actions, jobs, model_cache
from ..errors import ChonaError


class CHONA_OT_create_rig(bpy.types.Operator):
    """Create an armature in T-pose for the person and an empty for each object of the model"""

    bl_idname = "chona.create_rig"
    bl_label = "Create Rig"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Go to Object Mode first")
            return False
        if not context.scene.chona.model_path:
            cls.poll_message_set("Choose a model file first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            self.report({"INFO"}, actions.make_rig(context.scene))
        except ChonaError as error:
            return jobs.fail(self, error)
        return {"FINISHED"}


class CHONA_OT_object_add(bpy.types.Operator):
    """Add an object of the model to the actor, moved by the active object if that is an empty"""

    bl_idname = "chona.object_add"
    bl_label = "Add Object"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.chona.model_path:
            cls.poll_message_set("Choose a model file first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.chona
        present = {item.name for item in settings.objects}
        free = [name for name in model_cache.object_names(settings.model_path) if name not in present]
        item = settings.objects.add()
        item.name = free[0] if free else ""
        active = context.active_object
        if active is not None and active.type == "EMPTY":
            item.empty = active
        settings.active_object = len(settings.objects) - 1
        return {"FINISHED"}


class CHONA_OT_object_remove(bpy.types.Operator):
    """Remove the selected object from the actor; its empty stays in the scene"""

    bl_idname = "chona.object_remove"
    bl_label = "Remove Object"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.chona.objects:
            cls.poll_message_set("The list of objects is empty")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.chona
        settings.objects.remove(settings.active_object)
        settings.active_object = min(settings.active_object, max(len(settings.objects) - 1, 0))
        return {"FINISHED"}


CLASSES = (CHONA_OT_create_rig, CHONA_OT_object_add, CHONA_OT_object_remove)

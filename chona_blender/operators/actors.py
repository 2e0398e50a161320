"""Operators for the list of actors, and for who and what they are."""

from __future__ import annotations

import bpy

from .. import actions, messages, model_cache
from ..errors import ChonaError
from ..rig.armature import create_empty
from .poll import needs, needs_model

NOBODY = "(nobody)"
"""Instead of a person: the objects alone."""

_shown: dict[str, list[tuple[str, str, str]]] = {}
"""Items of drop-downs: Blender keeps no reference to their texts."""


def _persons(_self: object, context: bpy.types.Context) -> list[tuple[str, str, str]]:
    actor = context.scene.chona.actor
    names = model_cache.person_names(actor.model_path) if actor is not None else []
    _shown["persons"] = [(name, name, f"Render {name}") for name in names]
    _shown["persons"].append((NOBODY, "Nobody", "Render the objects alone"))
    return _shown["persons"]


def _objects(_self: object, context: bpy.types.Context) -> list[tuple[str, str, str]]:
    actor = context.scene.chona.actor
    names = model_cache.object_names(actor.model_path) if actor is not None else []
    present = {item.name for item in actor.objects} if actor is not None else set()
    free = [name for name in names if name not in present] or names
    _shown["objects"] = [(name, name, f"Render {name} with this actor") for name in free]
    return _shown["objects"]


class CHONA_OT_actor_add(bpy.types.Operator):
    """Add an actor with the same model; actors are rendered together and hide each other by depth"""

    bl_idname = "chona.actor_add"
    bl_label = "Add Actor"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.scene is not None, "There is no scene")

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.chona
        path = settings.model_path
        actor = settings.actors.add()
        settings.active_actor = len(settings.actors) - 1
        actor.model_path = path
        active = context.active_object
        taken = {other.armature for other in settings.actors}
        if active is not None and active.type == "ARMATURE" and active not in taken:
            actor.armature = active
        return {"FINISHED"}


class CHONA_OT_actor_remove(bpy.types.Operator):
    """Remove the selected actor; its armature and empties stay in the scene"""

    bl_idname = "chona.actor_remove"
    bl_label = "Remove Actor"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.scene.chona.actors, "The list of actors is empty")

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.chona
        settings.actors.remove(min(settings.active_actor, len(settings.actors) - 1))
        settings.active_actor = min(settings.active_actor, max(len(settings.actors) - 1, 0))
        return {"FINISHED"}


class CHONA_OT_choose_person(bpy.types.Operator):
    """Choose which of the model's people is rendered"""

    bl_idname = "chona.choose_person"
    bl_label = "Choose Person"
    bl_options = {"REGISTER", "UNDO"}

    person: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Person", description="Which of the model's people is rendered", items=_persons
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs_model(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.chona.ensure_actor().person = "" if self.person == NOBODY else self.person
        return {"FINISHED"}


class CHONA_OT_object_add(bpy.types.Operator):
    """Add an object of the model to the actor: moved by the active empty if it moves nothing yet, else by a new
    empty"""

    bl_idname = "chona.object_add"
    bl_label = "Add Object"
    bl_options = {"REGISTER", "UNDO"}

    object: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Object", description="Object of the model", items=_objects
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs_model(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        actor = context.scene.chona.ensure_actor()
        try:
            header = model_cache.load(actor.model_path)
            name = self.object or next(iter(header.objects), "")
            if not name:
                raise ChonaError(f"model '{header.path.name}' has no objects; train one on captures with an object")
            empty = _free_empty(context) or create_empty(
                context.scene, header, name, _in_front(actor), actor.armature if actor.person else None
            )
        except ChonaError as error:
            return messages.fail(self, error)
        item = actor.objects.add()
        item.name, item.empty = name, empty
        actor.active_object = len(actor.objects) - 1
        return {"FINISHED"}


def _free_empty(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object, where it is an empty that moves no object of any actor."""
    active = context.active_object
    moving = {item.empty for actor in context.scene.chona.actors for item in actor.objects}
    return active if active is not None and active.type == "EMPTY" and active not in moving else None


def _in_front(actor: bpy.types.PropertyGroup) -> list[float]:
    """A place on the floor a step before the actor, who faces −y, and beside the objects that are there."""
    place = actor.armature.matrix_world.translation if actor.armature is not None else (0.0, 0.0, 0.0)
    return [place[0] + 0.8 * len(actor.objects), place[1] - 1.0, 0.0]


class CHONA_OT_object_remove(bpy.types.Operator):
    """Remove the selected object from the actor; its empty stays in the scene"""

    bl_idname = "chona.object_remove"
    bl_label = "Remove Object"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.scene.chona.objects, "The list of objects is empty")

    def execute(self, context: bpy.types.Context) -> set[str]:
        actor = context.scene.chona.actor
        actor.objects.remove(min(actor.active_object, len(actor.objects) - 1))
        actor.active_object = min(actor.active_object, max(len(actor.objects) - 1, 0))
        return {"FINISHED"}


class CHONA_OT_create_rig(bpy.types.Operator):
    """Create an armature in T-pose for the person and an empty for each object of the model"""

    bl_idname = "chona.create_rig"
    bl_label = "Create Rig"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.mode == "OBJECT", "Go to Object Mode first") and needs_model(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            self.report({"INFO"}, actions.make_rig(context.scene))
        except ChonaError as error:
            return messages.fail(self, error)
        return {"FINISHED"}


CLASSES = (
    CHONA_OT_actor_add,
    CHONA_OT_actor_remove,
    CHONA_OT_choose_person,
    CHONA_OT_create_rig,
    CHONA_OT_object_add,
    CHONA_OT_object_remove,
)

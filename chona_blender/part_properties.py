"""The parts of an actor as the user sets them: what moves each object and each bone.

Blender reads the annotations of property classes, so they are not postponed here.
"""

from typing import TYPE_CHECKING

import bpy

from . import model_cache
from .rig.mapping import FOLLOW

if TYPE_CHECKING:
    from .actor_properties import CHONA_PG_actor

FOUND, FOLLOWS, MISSING = "FOUND", "FOLLOWS", "MISSING"
STATES = (
    (FOUND, "Found", "Moved by a bone of the armature"),
    (FOLLOWS, "Follows", "Keeps to its parent: the armature has no bone for it, and it can do without"),
    (MISSING, "Missing", "The armature has no bone for it, and it needs one"),
)


def _target_changed(self: "CHONA_PG_bone", _context: bpy.types.Context) -> None:
    self.actor.refresh_bones()


def _search_objects(self: "CHONA_PG_object", _context: bpy.types.Context, text: str) -> list[str]:
    return [name for name in model_cache.object_names(self.actor.model_path) if text.lower() in name.lower()]


def _search_bones(self: "CHONA_PG_bone", _context: bpy.types.Context, text: str) -> list[str]:
    armature = self.actor.armature
    names = [FOLLOW, *(armature.data.bones.keys() if armature is not None else ())]
    return [name for name in names if text.lower() in name.lower()]


class CHONA_PG_object(bpy.types.PropertyGroup):
    """One object of an actor and what moves it."""

    name: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Object",
        description="Name of the object in the model",
        search=_search_objects,
    )
    empty: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Moved By",
        description="The empty, or any object, whose position and rotation the object follows: keys, constraints, "
        "parents and rigid body physics count",
        type=bpy.types.Object,
    )
    use: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Render",
        description="Render this object; switched off it is not there and costs nothing",
        default=True,
    )

    @property
    def actor(self) -> "CHONA_PG_actor":
        """Whose object it is."""
        return self.id_data.path_resolve(self.path_from_id().rpartition(".objects[")[0])


class CHONA_PG_bone(bpy.types.PropertyGroup):
    """One bone of the model and the armature's bone for it."""

    name: bpy.props.StringProperty(name="Bone", description="Bone of the model")  # type: ignore[valid-type]
    target: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Moved By",
        description="Bone of the armature that moves this one; empty takes the one that was recognised, (parent) keeps "
        "it to its parent",
        search=_search_bones,
        update=_target_changed,
    )
    found: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Recognised",
        description="Bones of the armature that move this one, recognised by name",
        options={"SKIP_SAVE"},
    )
    state: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="State",
        description="Whether anything moves this bone",
        items=STATES,
        default=MISSING,
        options={"SKIP_SAVE"},
    )

    @property
    def actor(self) -> "CHONA_PG_actor":
        """Whose bone it is."""
        return self.id_data.path_resolve(self.path_from_id().rpartition(".bones[")[0])

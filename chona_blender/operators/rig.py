"""Operators that map an armature's bones to a model's, and its presets."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase

from .. import messages, model_cache
from ..errors import ChonaError
from ..readiness import NO_MODEL
from ..rig.mapping import map_rig
from . import actors, check
from .poll import allowed, needs

PRESET_FOLDER = "chona/rig"
"""Under presets/ of Blender's user scripts."""


def _has_rig(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Whether there is a table of bones to work on; else a poll message says what to do."""
    actor = context.scene.chona.actor
    reasons = (
        (actor is None or not actor.model_path, NO_MODEL),
        (actor is not None and not actor.person, "Choose a person first: objects have no bones"),
        (actor is not None and actor.armature is None, "Choose an armature first"),
    )
    return allowed(cls, next((words for off, words in reasons if off), ""))


class CHONA_OT_map_rig(bpy.types.Operator):
    """Recognise the armature's bones by their names: SMPL, Rigify, Mixamo, MPFB, Unreal, VRM, Unity, left and right
    names"""

    bl_idname = "chona.map_rig"
    bl_label = "Map Rig"
    bl_options = {"REGISTER", "UNDO"}

    keep: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Keep Choices",
        description="Keep the bones that were chosen in the table, and recognise the others",
        default=False,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_rig(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        actor = context.scene.chona.actor
        try:
            header = model_cache.load(actor.model_path)
            if not self.keep:
                actor.bones.clear()
            actor.refresh_bones()
            mapping = map_rig(actor.armature, header.names, actor.chosen_bones())
        except ChonaError as error:
            return messages.fail(self, error)
        if mapping.problems:
            missing = ", ".join(mapping.problems)
            self.report({"WARNING"}, f"{mapping.summary}. Choose bones for: {missing}")
            actor.active_bone = list(header.names).index(next(iter(mapping.problems)))
        else:
            self.report({"INFO"}, f"Recognised {mapping.summary}")
        return {"FINISHED"}


class CHONA_OT_bone_pick(bpy.types.Operator):
    """Let the selected bone of the armature move the selected bone of the table"""

    bl_idname = "chona.bone_pick"
    bl_label = "Use Selected Bone"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not _has_rig(cls, context):
            return False
        bone = context.scene.chona.actor.armature.data.bones.active
        return needs(cls, bone is not None, "Select a bone of the armature in Pose Mode first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        actor = context.scene.chona.actor
        actor.refresh_bones()
        if not actor.bones:
            return messages.fail(self, ChonaError("the table of bones is empty; choose a model that can be read"))
        row = actor.bones[min(actor.active_bone, len(actor.bones) - 1)]
        row.target = actor.armature.data.bones.active.name
        self.report({"INFO"}, f"'{row.target}' moves '{row.name}'")
        return {"FINISHED"}


class CHONA_MT_rig_presets(bpy.types.Menu):
    """Mappings that were saved."""

    bl_label = "Mapping Presets"
    preset_subdir = PRESET_FOLDER
    preset_operator = "script.execute_preset"
    draw = bpy.types.Menu.draw_preset


class CHONA_OT_rig_preset_add(AddPresetBase, bpy.types.Operator):
    """Save the table of bones as a preset, for the next rig of this kind; or remove the preset that is shown"""

    bl_idname = "chona.rig_preset_add"
    bl_label = "Save Mapping"
    preset_menu = "CHONA_MT_rig_presets"

    name: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Name", description="Name of the preset", maxlen=64, options={"SKIP_SAVE"}
    )
    remove_name: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Remove", description="Remove the preset of this name", default=False, options={"HIDDEN", "SKIP_SAVE"}
    )
    remove_active: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Remove Shown",
        description="Remove the preset that was chosen last",
        default=False,
        options={"HIDDEN", "SKIP_SAVE"},
    )
    preset_subdir = PRESET_FOLDER
    preset_defines: tuple[str, ...] = ("actor = bpy.context.scene.chona.ensure_actor()",)
    preset_values: tuple[str, ...] = ("actor.root_path", "actor.mapping")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.scene.chona.actor is not None, NO_MODEL)


CLASSES = (
    *actors.CLASSES,
    CHONA_OT_map_rig,
    CHONA_OT_bone_pick,
    CHONA_MT_rig_presets,
    CHONA_OT_rig_preset_add,
    *check.CLASSES,
)

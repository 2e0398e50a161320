"""Operators that put the baked frames into the compositor and take them out.

Blender reads the annotations of operators' properties, so they are not postponed here.
"""

import bpy

from .. import actions, compositing, messages
from ..errors import ChonaError
from ..output import bake_output, output_now
from .poll import needs


class CHONA_OT_composite(bpy.types.Operator):
    """Put the baked frames into the scene's compositor by depth, or update them there; your nodes stay as they are"""

    bl_idname = "chona.composite"
    bl_label = "Composite"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(
            cls, output_now(context.scene), "Set the output folder that holds the baked frames, and their name, first"
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            result = actions.add_composite(context.scene)
        except ChonaError as error:
            return messages.fail(self, error)
        for words in result.warnings:
            self.report({"WARNING"}, words)
        self.report({"INFO"}, result.message)
        return {"FINISHED"}


class CHONA_OT_composite_remove(bpy.types.Operator):
    """Take the baked frames out of the scene's compositor and leave it as it was before"""

    bl_idname = "chona.composite_remove"
    bl_label = "Remove from Compositor"
    bl_options = {"REGISTER", "UNDO"}

    layer: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Layer",
        description="Name of the bake whose layer goes; empty is the one that the Bake panel names",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, compositing.has_layers(context.scene), "The scene's compositor has no CHONA layer")

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        try:
            name = self.layer or bake_output(scene).name
            removed = compositing.remove_layer(scene, name)
        except ChonaError as error:
            return messages.fail(self, error)
        if not removed:
            names = ", ".join(compositing.layer_names(scene))
            return messages.fail(self, ChonaError(f"there is no layer {name!r}; the scene has: {names}"))
        self.report({"INFO"}, f"Removed {compositing.layer_group_name(name)}")
        return {"FINISHED"}


CLASSES = (CHONA_OT_composite, CHONA_OT_composite_remove)

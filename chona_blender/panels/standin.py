"""The stand-in of the selected actor."""

from __future__ import annotations

import bpy

from .. import standin
from .sidebar import Sidebar


class CHONA_PT_stand_in(Sidebar, bpy.types.Panel):
    """A mesh that follows the rig while it is posed."""

    bl_idname = "CHONA_PT_stand_in"
    bl_label = "Stand-In"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.chona.actor is not None

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona.actor.stand_in
        column = self.columns()
        column.prop(settings, "voxel")
        if context.scene.chona.actor.person:
            column.row().prop(settings, "follow", expand=True)
        row = self.layout.row(align=True)
        present = standin.stand_ins(context.scene.chona.actor)
        row.operator(
            "chona.stand_in_make", text="Renew Stand-In" if present else "Make Stand-In", icon="OUTLINER_OB_MESH"
        )
        row.operator("chona.stand_in_remove", text="", icon="X")
        if not present:
            return
        self.layout.use_property_split = False
        column = self.layout.column(align=True)
        column.label(text="In Renders:")
        grid = column.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
        grid.prop(settings, "use", expand=True)
        self.layout.prop(settings, "use_proxy")
        if context.space_data is not None and context.space_data.type == "VIEW_3D":
            shading = context.space_data.shading
            if shading.type == "SOLID" and shading.color_type != "VERTEX":
                self.layout.prop_enum(shading, "color_type", "VERTEX", text="Show Colors in This View", icon="COLOR")


CLASSES = (CHONA_PT_stand_in,)

"""Who is rendered, and what poses them."""

from __future__ import annotations

import bpy

from .sidebar import Sidebar


class CHONA_UL_objects(bpy.types.UIList):
    """Objects of the actor with what moves each."""

    def draw_item(
        self,
        _context: bpy.types.Context,
        layout: bpy.types.UILayout,
        _data: object,
        item: bpy.types.PropertyGroup,
        _icon: int,
        _active_data: object,
        _active_property: str,
    ) -> None:
        row = layout.row(align=True)
        row.prop(item, "use", text="")
        parts = row.split(factor=0.45, align=True)
        parts.prop(item, "name", text="", emboss=False)
        part = parts.row(align=True)
        part.alert = item.use and item.empty is None
        part.prop(item, "empty", text="")


class CHONA_PT_rig(Sidebar, bpy.types.Panel):
    """Who is rendered and what poses them."""

    bl_idname = "CHONA_PT_rig"
    bl_label = "Rig"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        column = self.columns()
        column.prop(settings, "person", icon="USER")
        column.prop(settings, "armature", icon="ARMATURE_DATA")
        self.layout.use_property_split = False  # a list's rows have no labels on the left
        self.layout.label(text="Objects and what moves them:")
        row = self.layout.row()
        row.template_list("CHONA_UL_objects", "", settings, "objects", settings, "active_object", rows=2)
        buttons = row.column(align=True)
        buttons.operator("chona.object_add", text="", icon="ADD")
        buttons.operator("chona.object_remove", text="", icon="REMOVE")
        self.layout.operator("chona.create_rig", icon="OUTLINER_OB_ARMATURE")


CLASSES = (CHONA_UL_objects, CHONA_PT_rig)

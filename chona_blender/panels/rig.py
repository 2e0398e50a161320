"""Who is rendered, and what poses them."""

from __future__ import annotations

import bpy

from ..part_properties import FOLLOWS, FOUND
from . import check
from .sidebar import Sidebar, wrapped

_ROW_ICONS = {FOUND: "CHECKMARK", FOLLOWS: "DOT"}


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
        actor = context.scene.chona.actor
        if actor is None:
            self.layout.operator("chona.create_rig", icon="OUTLINER_OB_ARMATURE")
            return
        column = self.columns()
        row = column.split(factor=0.4, align=True)
        row.alignment = "RIGHT"
        row.label(text="Person")
        row.operator_menu_enum("chona.choose_person", "person", text=actor.person or "Nobody", icon="USER")
        column.prop(actor, "armature", icon="ARMATURE_DATA")
        if actor.family:
            missing = "missing" in actor.family
            wrapped(self.layout, actor.family, icon="ERROR" if missing else "CHECKMARK", context=context)
        if actor.armature is not None and actor.person:
            self.columns().prop(actor, "root_path")
        self.layout.use_property_split = False  # a list's rows have no labels on the left
        self.layout.label(text="Objects and what moves them:")
        row = self.layout.row()
        row.template_list("CHONA_UL_objects", "", actor, "objects", actor, "active_object", rows=2)
        buttons = row.column(align=True)
        buttons.operator_menu_enum("chona.object_add", "object", text="", icon="ADD")
        buttons.operator("chona.object_remove", text="", icon="REMOVE")
        row = self.layout.row(align=True)
        row.operator("chona.create_rig", icon="OUTLINER_OB_ARMATURE")
        row.operator("chona.map_rig", icon="BONE_DATA")


class CHONA_UL_bones(bpy.types.UIList):
    """The model's bones and the armature's."""

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
        parts = layout.split(factor=0.46, align=True)
        parts.label(text=item.name, icon=_ROW_ICONS.get(item.state, "ERROR"))
        part = parts.row(align=True)
        part.alert = item.state not in _ROW_ICONS
        words = item.found or ("keeps to its parent" if item.state == FOLLOWS else "no bone")
        part.prop(item, "target", text="", placeholder=words)


class CHONA_PT_bones(Sidebar, bpy.types.Panel):
    """Which bone moves which, and presets of that."""

    bl_idname = "CHONA_PT_bones"
    bl_label = "Bones"
    bl_parent_id = "CHONA_PT_rig"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        actor = context.scene.chona.actor
        return actor is not None and actor.armature is not None

    def draw(self, context: bpy.types.Context) -> None:
        actor = context.scene.chona.actor
        row = self.layout.row(align=True)
        menu = bpy.types.CHONA_MT_rig_presets
        row.menu(menu.__name__, text=menu.bl_label)
        row.operator("chona.rig_preset_add", text="", icon="ADD")
        row.operator("chona.rig_preset_add", text="", icon="REMOVE").remove_active = True
        if not actor.bones:
            wrapped(self.layout, "Choose a person, then press Map Rig", icon="INFO", context=context)
            return
        self.layout.template_list("CHONA_UL_bones", "", actor, "bones", actor, "active_bone", rows=8)
        row = self.layout.row(align=True)
        row.operator("chona.bone_pick", text="Use Selected", icon="EYEDROPPER")
        row.operator("chona.map_rig", text="Find Others", icon="FILE_REFRESH").keep = True


CLASSES = (CHONA_UL_objects, CHONA_UL_bones, CHONA_PT_rig, CHONA_PT_bones, *check.CLASSES)

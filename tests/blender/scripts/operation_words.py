"""Every label and description that the add-on shows, from what is registered."""

from __future__ import annotations

import bpy
from operation_scene import say

import chona_blender
from chona_blender import registration

chona_blender.register()
found = []
groups = {cls.__name__ for cls in registration.CLASSES if issubclass(cls, bpy.types.PropertyGroup)}
for cls in registration.CLASSES:
    entry = {"name": cls.__name__, "kind": "", "label": getattr(cls, "bl_label", ""), "properties": []}
    rna = cls.bl_rna
    if issubclass(cls, bpy.types.Operator):
        rna = getattr(bpy.ops.chona, cls.bl_idname.partition(".")[2]).get_rna_type()
        entry["description"], entry["kind"] = rna.description, "Operator"
    elif issubclass(cls, bpy.types.Panel):
        entry["kind"] = "Panel"
    own = [p for p in rna.properties if p.identifier in getattr(cls, "__annotations__", ())]
    for each in own:
        if each.type == "POINTER" and each.fixed_type.identifier in groups:
            continue  # settings of a subject: never shown as one
        items = [[i.name, i.description] for i in each.enum_items] if each.type == "ENUM" else []
        entry["properties"].append(
            [each.identifier, each.name, each.description, "HIDDEN" if each.is_hidden else "", items]
        )
    found.append(entry)
say({"classes": found})

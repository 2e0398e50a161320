"""Baked frames in the scene's compositor."""

from __future__ import annotations

import bpy

from .. import compositing
from .sidebar import Sidebar


class CHONA_PT_composite(Sidebar, bpy.types.Panel):
    """Baked frames in the scene's compositor."""

    bl_idname = "CHONA_PT_composite"
    bl_label = "Composite"

    def draw(self, context: bpy.types.Context) -> None:
        row = self.layout.row(align=True)
        present = compositing.has_layers(context.scene)
        row.operator("chona.composite", text="Update" if present else "Composite", icon="NODE_COMPOSITING")
        row.operator("chona.composite_remove", text="Remove", icon="X")
        if present:
            for name in compositing.layer_names(context.scene):
                self.layout.label(text=compositing.layer_group_name(name), icon="NODETREE")
        self.layout.operator("chona.open_output", icon="FILE_FOLDER")


CLASSES = (CHONA_PT_composite,)

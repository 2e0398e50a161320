"""Baked frames in the scene's compositor."""

from __future__ import annotations

import bpy

from .. import compositing
from ..output import output_now
from .sidebar import Sidebar, wrapped


class CHONA_PT_composite(Sidebar, bpy.types.Panel):
    """Baked frames in the scene's compositor."""

    bl_idname = "CHONA_PT_composite"
    bl_label = "Composite"

    def draw(self, context: bpy.types.Context) -> None:
        scene = context.scene
        settings = scene.chona.composite
        column = self.columns()
        column.row().prop(settings, "edges", expand=True)
        column.prop(settings, "shadows")
        column.prop(settings, "cryptomatte")
        column.prop(settings, "stand_in")
        names = compositing.layer_names(scene) if compositing.has_layers(scene) else []
        output = output_now(scene)
        present = output is not None and output.name in names
        self.layout.operator("chona.composite", text="Update" if present else "Composite", icon="NODE_COMPOSITING")
        for name in names:
            row = self.layout.row(align=True)
            row.label(text=compositing.layer_group_name(name), icon="NODETREE")
            row.operator("chona.composite_remove", text="", icon="X", emboss=False).layer = name
            words = compositing.size_words(scene, name)
            if words:
                wrapped(self.layout, words, "ERROR", context)
        if compositing.has_layers(scene) and not names:
            self.layout.operator("chona.composite_remove", text="Clean Up", icon="X")
        self.layout.operator("chona.open_output", icon="FILE_FOLDER")


CLASSES = (CHONA_PT_composite,)

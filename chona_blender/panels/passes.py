"""Which passes a bake writes."""

from __future__ import annotations

import bpy

from .sidebar import Sidebar


class CHONA_PT_passes(Sidebar, bpy.types.Panel):
    """Passes of baked frames, in groups as a view layer has them."""

    bl_idname = "CHONA_PT_passes"
    bl_label = "Passes"
    bl_parent_id = "CHONA_PT_bake"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.chona
        column = self.columns()
        include = column.column(heading="Include", align=True)
        for name in ("depth", "normal", "confidence"):
            include.prop(settings.passes, name)
        mattes = column.column(heading="Mattes", align=True)
        mattes.prop(settings.passes, "mattes", text="Human and Object")
        mattes.prop(settings.passes, "cryptomatte")
        if settings.composite_after and not settings.passes.depth:
            column.label(text="Then Composite needs Depth", icon="ERROR")


CLASSES = (CHONA_PT_passes,)

"""Motion blur and depth of field of baked frames."""

from __future__ import annotations

import bpy

from .sidebar import Sidebar


class CHONA_PT_blur(Sidebar, bpy.types.Panel):
    """What of the scene's blur a bake takes along."""

    bl_idname = "CHONA_PT_blur"
    bl_label = "Motion Blur and Depth of Field"
    bl_parent_id = "CHONA_PT_bake"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        scene, settings = context.scene, context.scene.chona.blur
        camera = scene.camera
        focuses = camera is not None and camera.type == "CAMERA" and camera.data.dof.use_dof
        boxes = self.layout.column()
        boxes.use_property_split = False  # beside a split their names are too long for a sidebar
        boxes.prop(settings, "use_motion_blur")
        if settings.use_motion_blur and not scene.render.use_motion_blur:
            boxes.label(text="Off in the scene's render properties", icon="INFO")
        boxes.prop(settings, "use_depth_of_field")
        if settings.use_depth_of_field and not focuses:
            boxes.label(text="Off in the camera's properties", icon="INFO")
        part = self.columns()
        part.active = (settings.use_motion_blur and scene.render.use_motion_blur) or (
            settings.use_depth_of_field and focuses
        )
        part.prop(settings, "samples")


CLASSES = (CHONA_PT_blur,)

"""What the user sets for bakes and the live preview: part of `scene.chona`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import bpy

from . import presets
from .actor_properties import RELATIVE_PATH


def _preset_chosen(self: "BakeSettings", _context: bpy.types.Context) -> None:
    self.preset_name = self.preset


class BakeSettings:
    """Where frames go, how they are rendered, and which."""

    name: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Name",
        description="Name of the bake; frames are written as NAME_0001.exr",
        default="shot",
    )
    output_folder: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Output",
        description="Folder for the baked frames; // is the folder of the .blend file",
        subtype="DIR_PATH",
        options=RELATIVE_PATH,
        default="//chona/",
    )
    preset: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Quality",
        description="How exactly and how fast frames are rendered",
        items=presets.items,
        default=presets.DEFAULT,
        update=_preset_chosen,
    )
    preset_name: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Quality",
        description="Name of the chosen preset: the file of one of your own may be gone when this is opened again",
        options={"HIDDEN"},
    )
    max_error: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Max Error",
        description="Render pixels again, finer, until their colours (0 to 1) change by no more than this; 0 = off",
        default=0.0,
        min=0.0,
        max=0.5,
        step=0.1,
        precision=3,
    )
    use_scene_range: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Scene Range",
        description="Bake the frame range and step of the scene",
        default=True,
    )
    frame_start: bpy.props.IntProperty(name="First", description="First frame to bake", default=1)  # type: ignore[valid-type]
    frame_end: bpy.props.IntProperty(name="Last", description="Last frame to bake", default=50)  # type: ignore[valid-type]
    frame_step: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Step",
        description="Bake every so many frames",
        default=1,
        min=1,
    )
    overwrite: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Overwrite",
        description="Bake frames again that are there already and up to date; without, they are skipped",
    )
    composite_after: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Then Composite",
        description="Put the frames into the scene's compositor when the bake has finished",
        default=True,
    )

    live_opacity: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Opacity",
        description="How much the live preview covers; less than 1 lets the bones under it shine through",
        default=1.0,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )

    def frames(self) -> list[int]:
        """The frames to bake, increasing; empty when the range is."""
        scene = self.id_data
        if self.use_scene_range:
            return list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
        return list(range(self.frame_start, self.frame_end + 1, self.frame_step))

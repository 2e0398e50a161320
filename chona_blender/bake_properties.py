"""What the user sets for bakes and the live preview: part of `scene.chona`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import bpy

from . import presets
from .actor_properties import RELATIVE_PATH
from .bake_frames import RANGES, SCENE, frames_of

UPDATE, KEEP, OVERWRITE = "UPDATE", "KEEP", "OVERWRITE"
EXISTING = (
    (UPDATE, "Update", "Bake frames that are missing or out of date: pose, camera, settings or model have changed"),
    (KEEP, "Keep", "Bake only frames that have no file; others stay as they are, also those that are out of date"),
    (OVERWRITE, "Overwrite", "Bake all frames again"),
)


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
    use_scene_output: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Use Scene's Output",
        description="Write into a folder beside the scene's own output, under the name that its files have there",
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
    frame_range: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Frames",
        description="Which frames to bake",
        items=RANGES,
        default=SCENE,
    )
    frame_start: bpy.props.IntProperty(name="First", description="First frame to bake", default=1)  # type: ignore[valid-type]
    frame_end: bpy.props.IntProperty(name="Last", description="Last frame to bake", default=50)  # type: ignore[valid-type]
    frame_step: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Step",
        description="Bake every so many frames",
        default=1,
        min=1,
    )
    existing: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Existing Frames",
        description="What happens to frames that have a file already",
        items=EXISTING,
        default=UPDATE,
    )
    composite_after: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Then Composite",
        description="Put the frames into the scene's compositor when the bake has finished",
        default=True,
    )

    detach: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Keep Running",
        description="A bake or training goes on when Blender is closed or crashes, and the next Blender that opens "
        "this file shows how far it is. Off, it ends with Blender",
        default=False,
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
        return frames_of(self.id_data)

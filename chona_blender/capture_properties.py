"""What the user sets for captures: part of `scene.chona`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import bpy

from .actor_properties import RELATIVE_PATH


def _is_armature(_self: bpy.types.PropertyGroup, candidate: bpy.types.Object) -> bool:
    return candidate.type == "ARMATURE"


class CaptureSettings:
    """Whom to capture, into which folder, and with which cameras."""

    capture_folder: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Folder",
        description="Folder for the capture; several sequences may go into one",
        subtype="DIR_PATH",
        options=RELATIVE_PATH,
        default="//chona_capture/",
    )
    capture_armature: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Character",
        description="The armature of the character to learn; every mesh that it deforms or carries is captured with it",
        type=bpy.types.Object,
        poll=_is_armature,
    )
    capture_object: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Object",
        description="The object that the character handles: a mesh, or an empty with meshes under it; none for a "
        "character alone",
        type=bpy.types.Object,
    )
    capture_person: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Person",
        description="Name that the character gets in the model; empty takes the armature's",
    )
    capture_sequence: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Sequence",
        description="Name of this performance in the capture; empty takes the names of character and object",
    )
    capture_cameras: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Cameras",
        description="Number of cameras in a ring around the performance",
        default=8,
        min=1,
        soft_max=32,
    )
    capture_width: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Width",
        description="Width of the captured images",
        default=512,
        min=16,
        subtype="PIXEL",
    )
    capture_height: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Height",
        description="Height of the captured images",
        default=384,
        min=16,
        subtype="PIXEL",
    )
    capture_samples: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Samples",
        description="Cycles samples a pixel of the colour images",
        default=32,
        min=1,
    )

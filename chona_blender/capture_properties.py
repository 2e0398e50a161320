"""What the user sets for captures: part of `scene.chona`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import bpy

from . import ring_view
from .actor_properties import RELATIVE_PATH
from .bake_frames import CUSTOM, RANGES, SCENE
from .capture_ring import Ring


def _is_armature(_self: bpy.types.PropertyGroup, candidate: bpy.types.Object) -> bool:
    return candidate.type == "ARMATURE"


def _performance_changed(self: "CaptureSettings", _context: bpy.types.Context) -> None:
    ring_view.refresh(self.id_data)


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
        update=_performance_changed,
    )
    capture_object: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Object",
        description="The object that the character handles: a mesh, or an empty with meshes under it; none for a "
        "character alone",
        type=bpy.types.Object,
        update=_performance_changed,
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
    capture_rings: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Rings",
        description="Number of rings, one above the other; the cameras of every second one stand in between",
        default=1,
        min=1,
        soft_max=5,
    )
    capture_radius: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Radius",
        description="Distance of the cameras from the middle of the performance; 0 fits it so that all see everything",
        default=0.0,
        min=0.0,
        soft_max=20.0,
        unit="LENGTH",
    )
    capture_ring_height: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Height",
        description="How much higher the middle of the rings is than that of the performance",
        default=0.0,
        soft_min=-5.0,
        soft_max=5.0,
        unit="LENGTH",
    )
    capture_ring_spacing: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Spacing",
        description="From one ring to the next, upwards",
        default=0.8,
        min=0.0,
        soft_max=5.0,
        unit="LENGTH",
    )
    capture_stagger: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Stagger",
        description="Every second camera of a ring is raised by this angle, to see what is hidden from the level ones",
        default=0.25,
        min=-1.2,
        max=1.2,
        subtype="ANGLE",
    )
    capture_lens: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Lens",
        description="Focal length on a sensor of 36 mm",
        default=40.0,
        min=1.0,
        soft_max=200.0,
        subtype="DISTANCE_CAMERA",
        unit="CAMERA",
    )
    capture_range: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Frames",
        description="Which frames to capture",
        items=[item for item in RANGES if item[0] in {SCENE, CUSTOM}],
        default=SCENE,
        update=_performance_changed,
    )
    capture_frame_start: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="First", description="First frame to capture", default=1, update=_performance_changed
    )
    capture_frame_end: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Last", description="Last frame to capture", default=50, update=_performance_changed
    )
    capture_frame_step: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Step",
        description="Capture every so many frames; neighbours look alike, and teach little",
        default=1,
        min=1,
        update=_performance_changed,
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

    def capture_frames(self) -> list[int]:
        """The frames to capture, increasing; empty when the range is."""
        scene = self.id_data
        if self.capture_range == SCENE:
            return list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
        return list(range(self.capture_frame_start, self.capture_frame_end + 1, self.capture_frame_step))

    def capture_ring(self) -> Ring:
        """How the cameras stand."""
        return Ring(
            self.capture_cameras, self.capture_rings, self.capture_radius, self.capture_ring_height,
            self.capture_ring_spacing, self.capture_lens, self.capture_stagger,
        )  # fmt: skip

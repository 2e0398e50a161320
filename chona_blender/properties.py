"""What the user sets, kept in the scene: `scene.chona`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

from collections.abc import Iterator

import bpy

from . import presets
from .actor_properties import RELATIVE_PATH, CHONA_PG_actor, CHONA_PG_object

FORMATS = (
    ("auto", "Automatic", "Recognise the kind of data from the folder"),
    ("behave", "BEHAVE", "A folder in the layout of the BEHAVE data set"),
    ("zju_mocap", "ZJU-MoCap", "A folder in the layout of the ZJU-MoCap data set"),
    ("co3d", "CO3D", "A folder in the layout of the CO3D data set"),
    ("transforms", "transforms.json", "Images and cameras as NeRF tools write them"),
    ("blender", "Blender capture", "A folder that Capture in this add-on wrote"),
)
TRAIN_PRESETS = (
    ("fast", "Fast", "Grid encodings and small networks: minutes on a processor"),
    ("paper", "Paper", "The networks of the paper: hours on a graphics card"),
)


def _preset_chosen(self: "CHONA_PG_settings", _context: bpy.types.Context) -> None:
    self.preset_name = self.preset


def _first_model_chosen(self: "CHONA_PG_settings", _context: bpy.types.Context) -> None:
    if self.first_model:
        self.ensure_actor().model_path = self.first_model
        self.first_model = ""


def _is_armature(_self: bpy.types.PropertyGroup, candidate: bpy.types.Object) -> bool:
    return candidate.type == "ARMATURE"


class CHONA_PG_settings(bpy.types.PropertyGroup):
    """Everything that one scene's actors, bake and training need.

    ``model_path``, ``person``, ``armature`` and ``objects`` are those of the selected actor: most scenes have only one.
    """

    actors: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=CHONA_PG_actor, name="Actors", description="Everybody and everything that is rendered together"
    )
    first_model: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Model",
        description="Model file (.safetensors) that a training wrote; choosing one makes the first actor",
        subtype="FILE_PATH",
        options=RELATIVE_PATH | {"SKIP_SAVE"},
        update=_first_model_chosen,
    )
    active_actor: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Actor",
        description="The selected row of the list of actors",
        options={"HIDDEN"},
    )

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

    data_folder: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Data",
        description="Folder with the captures to learn from",
        subtype="DIR_PATH",
        options=RELATIVE_PATH,
    )
    data_format: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Format",
        description="Layout of the data folder",
        items=FORMATS,
        default="auto",
    )
    sequences: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Sequences",
        description="Names of the sequences to learn from, with commas between; empty for all",
    )
    run_folder: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Result",
        description="Folder for the model, its log and its checkpoints",
        subtype="DIR_PATH",
        options=RELATIVE_PATH,
        default="//chona_model/",
    )
    train_preset: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Method",
        description="Which networks are trained",
        items=TRAIN_PRESETS,
        default="fast",
    )
    minutes: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Time",
        description="How long to train, in minutes",
        default=10.0,
        min=0.1,
        soft_max=600.0,
        subtype="UNSIGNED",
        precision=1,
    )
    measure_sequences: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Sequences",
        description="Names of the sequences to measure on, with commas between; best such that training did not see. "
        "Empty for all",
    )
    measure_minutes: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Time",
        description="How long to measure, in minutes; longer tries more views and more combinations",
        default=3.0,
        min=0.1,
        soft_max=60.0,
        subtype="UNSIGNED",
        precision=1,
    )
    resume: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Resume",
        description="Go on from the last checkpoint in the result folder",
    )

    def frames(self) -> list[int]:
        """The frames to bake, increasing; empty when the range is."""
        scene = self.id_data
        if self.use_scene_range:
            return list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
        return list(range(self.frame_start, self.frame_end + 1, self.frame_step))

    @property
    def actor(self) -> CHONA_PG_actor | None:
        """The selected actor; None where the scene has none."""
        return self.actors[min(self.active_actor, len(self.actors) - 1)] if self.actors else None

    def ensure_actor(self) -> CHONA_PG_actor:
        """The selected actor, made if there is none.  Not to be called while drawing."""
        if not self.actors:
            self.actors.add()
            self.active_actor = 0
        return self.actor  # type: ignore[return-value]

    @property
    def model_path(self) -> str:
        """Of the selected actor."""
        return self.actor.model_path if self.actor else ""

    @model_path.setter
    def model_path(self, value: str) -> None:
        self.ensure_actor().model_path = value

    @property
    def person(self) -> str:
        """Of the selected actor."""
        return self.actor.person if self.actor else ""

    @person.setter
    def person(self, value: str) -> None:
        self.ensure_actor().person = value

    @property
    def armature(self) -> bpy.types.Object | None:
        """Of the selected actor."""
        return self.actor.armature if self.actor else None

    @armature.setter
    def armature(self, value: bpy.types.Object | None) -> None:
        self.ensure_actor().armature = value

    @property
    def objects(self) -> "bpy.types.bpy_prop_collection | tuple":
        """Of the selected actor."""
        return self.actor.objects if self.actor else ()

    def used_actors(self) -> list[CHONA_PG_actor]:
        """The actors that are to be rendered."""
        return [actor for actor in self.actors if actor.use]

    def used_objects(self) -> Iterator[CHONA_PG_object]:
        """The selected actor's objects that are to be rendered."""
        return self.actor.used_objects() if self.actor else iter(())

    def set_objects(self, pairs: dict[str, bpy.types.Object | None]) -> None:
        """Replace the selected actor's list of objects."""
        self.ensure_actor().set_objects(pairs)


def register() -> None:
    """Give every scene its settings. The classes are registered already."""
    bpy.types.Scene.chona = bpy.props.PointerProperty(type=CHONA_PG_settings)


def unregister() -> None:
    """Take the settings' type away; values stay in saved files."""
    del bpy.types.Scene.chona

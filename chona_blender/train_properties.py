"""What the user sets for training and measuring a model: part of `scene.chona`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import bpy

from . import train_data
from .actor_properties import RELATIVE_PATH

FORMATS = (
    ("auto", "Automatic", "Recognise the kind of data from the folder"),
    ("behave", "BEHAVE", "A folder in the layout of the BEHAVE data set"),
    ("zju_mocap", "ZJU-MoCap", "A folder in the layout of the ZJU-MoCap data set"),
    ("co3d", "CO3D", "A folder in the layout of the CO3D data set"),
    ("transforms", "transforms.json", "Images and cameras as NeRF tools write them"),
    ("blender", "Blender capture", "A folder that Capture in this add-on wrote"),
)
SCANS = {"co3d", "transforms"}
"""Formats of objects without a scale of their own."""
TRAIN_PRESETS = (
    ("fast", "Fast", "Grid encodings and small networks: minutes on a processor"),
    ("paper", "Paper", "The networks of the paper: hours on a graphics card"),
)


def _data_chosen(self: "TrainSettings", _context: bpy.types.Context) -> None:
    train_data.look(self.id_data)


class TrainSettings:
    """What to learn from, how long, and where the model goes; and what to measure it on."""

    data_folder: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Data",
        description="Folder with the captures to learn from",
        subtype="DIR_PATH",
        options=RELATIVE_PATH,
        update=_data_chosen,
    )
    data_format: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Format",
        description="Layout of the data folder",
        items=FORMATS,
        default="auto",
        update=_data_chosen,
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
    object_size: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Object Size",
        description="Longest side of the scanned objects, which have no scale of their own",
        default=0.5,
        min=0.001,
        soft_max=10.0,
        subtype="DISTANCE",
        unit="LENGTH",
    )
    base_model: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Add To",
        description="A model that stays as it is: its copy in the result folder gets persons and objects of the data "
        "that are seen alone there. Empty to train a new one",
        subtype="FILE_PATH",
        options=RELATIVE_PATH,
    )
    identities: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Who",
        description="Names of the persons and objects to add, with commas between; SCAN=Bowl gives SCAN the name Bowl",
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
    train_steps: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Steps",
        description="How many steps to train, for the same model whenever it is trained; 0 goes by the time",
        default=0,
        min=0,
    )
    preview_every: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Picture Every",
        description="Draw what the model shows beside the truth as often, in seconds; takes a tenth of the time at "
        "most, and the model stays the same. 0 draws none",
        default=10.0,
        min=0.0,
        soft_max=600.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
        precision=0,
    )
    trainings: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Trainings",
        description="The list of trainings as it was when the file was saved",
        options={"HIDDEN"},
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

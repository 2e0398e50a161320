"""From a command's options to the scene's settings: options that are given replace what the file says."""

from __future__ import annotations

import argparse
from pathlib import Path

import bpy

from . import presets
from .bake_frames import CUSTOM
from .errors import ChonaError
from .frames import parse_frames

PATH_OPTIONS = {"model", "out", "data", "run_folder", "add_to", "capture_folder"}
CAPTURE_OPTIONS = tuple(
    f"capture_{name}"
    for name in (
        "person",
        "sequence",
        "folder",
        "cameras",
        "rings",
        "radius",
        "ring_height",
        "ring_spacing",
        "lens",
        "width",
        "height",
        "samples",
    )
)


def chosen_scene(name: str | None) -> bpy.types.Scene:
    """The scene to work on; without a name the file's active one."""
    if name is None:
        return bpy.context.scene
    if name not in bpy.data.scenes:
        raise ChonaError(f"there is no scene {name!r}; the file has: {', '.join(bpy.data.scenes.keys())}")
    return bpy.data.scenes[name]


def apply(scene: bpy.types.Scene, arguments: argparse.Namespace) -> None:
    """Put the options that were given into the scene's settings."""
    if arguments.save == "" and not bpy.data.filepath:  # before anything is done
        raise ChonaError("--save needs a file name, because the open file has none; write --save FILE.blend")
    settings = scene.chona
    given = {key: value for key, value in vars(arguments).items() if value is not None}
    for option, target in (
        ("model", "model_path"),
        ("person", "person"),
        ("name", "name"),
        ("max_error", "max_error"),
        ("out", "output_folder"),
        ("use_scene_output", "use_scene_output"),
        ("existing", "existing"),
        ("data", "data_folder"),
        ("format", "data_format"),
        ("sequences", "sequences"),
        ("run_folder", "run_folder"),
        ("object_size", "object_size"),
        ("add_to", "base_model"),
        ("who", "identities"),
        ("method", "train_preset"),
        ("minutes", "minutes"),
        ("steps", "train_steps"),
        ("resume", "resume"),
        *((name, name) for name in CAPTURE_OPTIONS),
    ):
        if option in given:
            setattr(settings, target, str(Path(given[option]).absolute()) if option in PATH_OPTIONS else given[option])
    if "out" in given:
        settings.use_scene_output = False
    if "preset" in given:
        settings.preset = presets.check(given["preset"])
    if "passes" in given:
        settings.passes.choose(given["passes"].split(","))
    if "motion_blur" in given:
        settings.blur.use_motion_blur = given["motion_blur"] == "on"
        scene.render.use_motion_blur = scene.render.use_motion_blur or settings.blur.use_motion_blur
    if "depth_of_field" in given:
        settings.blur.use_depth_of_field = given["depth_of_field"] == "on"
    if "blur_samples" in given:
        settings.blur.samples = given["blur_samples"]
    if "edges" in given:
        settings.composite.edges = given["edges"].upper()
    if "shadows" in given:
        settings.composite.shadows = given["shadows"] == "on"
    if "armature" in given:
        settings.armature = _object(given["armature"])
    for name in ("capture_armature", "capture_object"):
        if name in given:
            setattr(settings, name, _object(given[name]))
    if "object" in given:
        settings.set_objects(dict(_pair(text) for text in given["object"]))
    if "frames" in given:
        _set_frames(settings, given["frames"], "capture_" if arguments.command == "capture" else "")


def _set_frames(settings: bpy.types.PropertyGroup, text: str, subject: str) -> None:
    numbers = parse_frames(text)
    step = numbers[1] - numbers[0] if len(numbers) > 1 else 1
    if numbers != list(range(numbers[0], numbers[-1] + 1, step)):
        raise ChonaError(f"frames {text!r} are not one range with one step; run the command once for each range")
    setattr(settings, f"{subject}range" if subject else "frame_range", CUSTOM)
    for name, value in (("start", numbers[0]), ("end", numbers[-1]), ("step", step)):
        setattr(settings, f"{subject}frame_{name}", value)


def _object(name: str) -> bpy.types.Object:
    if name not in bpy.data.objects:
        raise ChonaError(f"there is no object {name!r} in the file; check its name in the outliner")
    return bpy.data.objects[name]


def _pair(text: str) -> tuple[str, bpy.types.Object]:
    name, equals, empty = text.partition("=")
    if not equals:
        raise ChonaError(f"--object {text!r} has no '='; write --object NAME_IN_THE_MODEL=EMPTY")
    return name, _object(empty)

"""The command line of the add-on without a window: its commands and their options."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import NoReturn

import bpy

from . import capture_command, learn_command, preferences, presets, standin_command, worker, worker_command
from .bake_properties import KEEP, OVERWRITE
from .passes_properties import PASSES
from .train_properties import FORMATS, TRAIN_PRESETS

Command = Callable[[bpy.types.Scene, argparse.Namespace], int]
EXIT_CODES = "Exit codes: 0 done; 1 failed or cancelled; 2 wrong arguments or input, said in one line on stderr."


class WrongArguments(Exception):
    """Arguments that cannot be understood."""


class Parser(argparse.ArgumentParser):
    """Raises `WrongArguments` instead of ending Blender."""

    def error(self, message: str) -> NoReturn:
        raise WrongArguments(f"{self.prog}: {message}; see {self.prog} --help")


def _bound(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 0.5:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 0.5")
    return value


def _samples(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 1024:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 1 to 1024")
    return int(text)


def make_parser(runs: Mapping[str, Command]) -> Parser:
    """The whole command line; `runs` is what runs, by the command's name."""
    parser = Parser(prog="chona", description="CHONA in Blender, without a window.", epilog=EXIT_CODES)
    commands = parser.add_subparsers(dest="command", required=True, parser_class=Parser)

    def add(name: str, words: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=words, description=words)
        command.set_defaults(run=runs[name], save=None)
        command.add_argument("--scene", metavar="NAME", help="scene to work on (default: the file's active one)")
        return command

    def actor(command: argparse.ArgumentParser) -> None:
        command.add_argument("--model", metavar="FILE", help="model file (.safetensors)")
        command.add_argument("--person", metavar="NAME", help="person of the model; '' for objects alone")

    def layer(command: argparse.ArgumentParser) -> None:
        command.add_argument("--out", metavar="FOLDER", help="folder of the baked frames")
        command.add_argument("--name", metavar="NAME", help="name of the bake; frames are NAME_0001.exr …")

    def blurred(command: argparse.ArgumentParser) -> None:
        command.add_argument("--motion-blur", choices=["on", "off"], help="blur what moves, by the scene's shutter")
        command.add_argument("--depth-of-field", choices=["on", "off"], help="blur by the camera's depth of field")
        command.add_argument("--blur-samples", type=_samples, metavar="N", help="rays a pixel of blurred frames")

    def composited(command: argparse.ArgumentParser) -> None:
        command.add_argument("--edges", choices=["depth", "refined"], help="of what is in front of the figure")
        command.add_argument("--shadows", choices=["on", "off"], help="stand-ins cast the figure's shadow unseen")

    def python(command: argparse.ArgumentParser) -> None:
        origin = f"the preferences', ${worker.PYTHON_VARIABLE}, the one of setup-worker"
        command.add_argument("--python", metavar="FILE", help=f"the worker's Python (default: {origin})")
        command.add_argument("--device", choices=[item[0] for item in preferences.DEVICES], help="what it computes on")

    def save(command: argparse.ArgumentParser) -> None:
        command.add_argument(
            "--save",
            nargs="?",
            const="",
            metavar="FILE.blend",
            help="save the file when done, under this name or its own",
        )

    def rigged(command: argparse.ArgumentParser) -> None:
        actor(command)
        command.add_argument("--armature", metavar="OBJECT", help="armature object that poses the person")
        command.add_argument(
            "--object", action="append", metavar="NAME=EMPTY",
            help="object of the model and what moves it; repeat for more",
        )  # fmt: skip

    def shot(command: argparse.ArgumentParser) -> None:
        rigged(command)
        command.add_argument("--frames", metavar="A-B[:STEP]", help="frames to bake (default: the settings')")
        command.add_argument("--preset", metavar="NAME", help=f"{', '.join(presets.OWN)}, or one of your own")
        python(command)

    one = add("bake", "Render the posed actor to EXR frames.")
    shot(one)
    layer(one)
    save(one)
    one.add_argument("--max-error", type=_bound, metavar="E", help="render pixels finer until they change by no more")
    one.add_argument(
        "--use-scene-output", action="store_const", const=True, help="write beside the scene's own output, by its name"
    )
    existing = one.add_mutually_exclusive_group()
    existing.add_argument(
        "--overwrite", dest="existing", action="store_const", const=OVERWRITE, help="bake all frames again"
    )
    existing.add_argument(
        "--only-missing", dest="existing", action="store_const", const=KEEP,
        help="leave every frame that has a file as it is, out of date or not (default: bake those again)",
    )  # fmt: skip
    one.add_argument("--passes", metavar="A,B,…", help=f"of {', '.join(PASSES)} (default: the settings')")
    blurred(one)
    one.add_argument("--composite", action="store_true", help="put the frames into the compositor when done")
    composited(one)

    one = add("shot", "Write what a bake would render, for baking on other computers; needs no worker.")
    rigged(one)
    layer(one)
    one.add_argument("--frames", metavar="A-B[:STEP]", help="frames of the shot (default: the settings')")
    one.add_argument(
        "--use-scene-output", action="store_const", const=True, help="write beside the scene's own output, by its name"
    )
    blurred(one)

    shot(add("estimate", "Predict the bake with each preset after timing this computer for two seconds."))

    one = add("composite", "Put baked frames into the scene's compositor by depth.")
    layer(one)
    save(one)
    one.add_argument("--remove", action="store_true", help="take them out instead")
    composited(one)

    one = add("create-rig", "Make an armature and empties for a model.")
    actor(one)
    save(one)
    one.add_argument("--objects", metavar="A,B", help="objects of the model (default: all)")

    one = add("capture", "Render training data of a rigged character.")
    one.add_argument("--capture-armature", metavar="OBJECT", help="armature of the character")
    one.add_argument(
        "--capture-object", metavar="OBJECT", help="what the character handles: a mesh, or an empty over some"
    )
    one.add_argument("--capture-person", metavar="NAME", help="name of the character in the model")
    one.add_argument("--capture-sequence", metavar="NAME", help="name of this performance")
    one.add_argument("--capture-folder", metavar="FOLDER", help="folder for the capture")
    one.add_argument("--capture-cameras", type=int, metavar="N", help="cameras in the ring")
    one.add_argument("--capture-width", type=int, metavar="PIXELS")
    one.add_argument("--capture-height", type=int, metavar="PIXELS")
    one.add_argument("--capture-samples", type=int, metavar="N", help="Cycles samples a pixel")
    one.add_argument("--frames", metavar="A-B[:STEP]", help="frames to capture (default: the settings')")
    capture_command.add_options(one)
    one.add_argument("--progress", choices=["text", "json"], default="text", help="how progress is told")

    one = add("train", "Learn a model from captures.")
    python(one)
    one.add_argument("--data", metavar="FOLDER", help="folder with the captures")
    one.add_argument("--format", choices=[item[0] for item in FORMATS], help="layout of the folder")
    one.add_argument("--sequences", metavar="A,B", help="sequences to learn from (default: all)")
    one.add_argument("--run-folder", metavar="FOLDER", help="folder for the model, its log and checkpoints")
    one.add_argument("--object-size", type=float, metavar="M", help="longest side of scanned objects, metres")
    one.add_argument("--add-to", metavar="FILE", help="a model that stays as it is; its copy gets --who")
    one.add_argument("--who", metavar="A,B=C", help="what it gets; B=C adds B by the name C")
    one.add_argument("--method", choices=[item[0] for item in TRAIN_PRESETS], help="which networks")
    one.add_argument("--minutes", type=float, metavar="M", help="how long")
    one.add_argument("--steps", type=int, metavar="N", help="how many steps, instead of a time")
    one.add_argument("--resume", action="store_const", const=True, help="go on from the last checkpoint")

    python(add("check", "Say whether the worker can work, and what to do if not."))
    learn_command.add_options(add, python)

    def carried(command: argparse.ArgumentParser) -> None:
        rigged(command)
        python(command)
        save(command)

    standin_command.add_options(add, carried)
    worker_command.add_options(add)
    return parser

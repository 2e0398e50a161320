"""The command line of ``chona``: its commands and their options."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from chona_model.arguments import Parser, SourceAction, frame_list, job_file, name_list, number, whole
from chona_model.passes import DEFAULT_PASSES, PASSES
from chona_model.progress import MODES, Progress
from chona_model.settings import BLURS, MOST_BLUR_SAMPLES, PRESETS
from chona_model.study_line import add_add, add_reproduce
from chona_model.training_line import add_training

METHODS = ("chona", "no-cil", "separate", "joint", "joint-no-cil", "object-translation", "tava", "arah", "arah-object")
"""Of ``methods.py``, which is not read before it is needed."""
TRAIN_PRESETS = ("fast", "paper")
MANAGERS = ("flamenco", "slurm")
DEFAULT_PRESET = "final"
PATIENCE = 120.0
"""Seconds: NFS clients show each other's changes up to 60 late."""
DEVICE_HELP = "what it computes on; auto takes CUDA where there is a card"
_PRESET_HELP = f"{', '.join(PRESETS)}, or one of yours (default: {DEFAULT_PRESET})"

Command = Callable[[argparse.Namespace, Progress], int]


def make_parser(commands_of: Mapping[str, Command]) -> Parser:
    """The whole command line.

    Args:
        commands_of: what runs, by the command's name.
    """
    parser = Parser(prog="chona", description="Train people and objects from captures, and bake posed shots to EXR.")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, dest="command")

    def add(name: str, words: str, long: bool = False) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=words, description=words[0].upper() + words[1:] + ".")
        command.set_defaults(run=commands_of[name])
        command.add_argument("--debug", action="store_true", help="show where an error happened")
        if long:
            add_progress(command)
            command.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help=DEVICE_HELP)
        return command

    def add_progress(command: argparse.ArgumentParser) -> None:
        command.add_argument("--progress", choices=MODES, default="terminal", help="a bar, or JSON lines on stdout")
        command.add_argument(
            "--until-closed", action="store_true",
            help="end when standard input is closed: with the program that started this",
        )  # fmt: skip
        command.add_argument(
            "--progress-file", type=job_file, metavar="FILE.json",
            help="say in this file, instead of on stdout, how far it is; a file FILE.stop ends it",
        )  # fmt: skip

    def add_detach(command: argparse.ArgumentParser) -> None:
        command.add_argument(
            "--detach", action="store_true",
            help="go on in a process that ends with nobody; says which, where it tells how far it is, how to end it",
        )  # fmt: skip

    train = add("train", "learn a model from captures", long=True)
    _add_sources(train, "repeat it with its own --format and --sequences or --split to train jointly")
    train.add_argument("--out", type=Path, required=True, metavar="RUN", help="folder for model, log and checkpoint")
    train.add_argument("--method", choices=METHODS, default="chona", help="default: chona")
    train.add_argument("--preset", choices=TRAIN_PRESETS, default="fast", help="the paper's take hours")
    add_training(train, steps="how many steps to train")

    add_detach(train)

    addition = add("add", "add a person or an object, seen alone, to a model that stays as it is", long=True)
    _add_sources(addition, "repeat it to add from several")
    add_add(addition)
    add_detach(addition)

    evaluate = add("evaluate", "measure a model on views it has not seen", long=True)
    evaluate.add_argument("--model", type=Path, required=True, metavar="FILE")
    _add_sources(evaluate, "repeat it to measure on several")
    evaluate.add_argument("--preset", default=DEFAULT_PRESET, metavar="P", help=_PRESET_HELP)
    evaluate.add_argument("--save-images", type=Path, metavar="DIR", help="folder for predictions and targets")
    evaluate.add_argument("--json", type=Path, required=True, metavar="FILE", help="the measurements")

    bake = add("bake", "render a shot to EXR frames", long=True)
    bake.add_argument("--model", type=Path, required=True, metavar="FILE")
    bake.add_argument("--shot", type=Path, required=True, metavar="FILE")
    bake.add_argument("--out", type=Path, required=True, metavar="DIR")
    bake.add_argument("--frames", type=frame_list, metavar="1-50,60", help="default: all of the shot")
    bake.add_argument("--preset", default=DEFAULT_PRESET, metavar="P", help=_PRESET_HELP)
    bake.add_argument(
        "--max-error", type=number(0, 0.5), default=0.0, metavar="E",
        help="render pixels again, finer, until their colour and alpha change by no more than this; 0: off",
    )  # fmt: skip
    bake.add_argument(
        "--max-memory", type=number(0, above=True), metavar="GB",
        help="cut frames so that the whole process takes no more; refused where the pictures alone do",
    )  # fmt: skip
    existing = bake.add_mutually_exclusive_group()
    existing.add_argument("--overwrite", action="store_true", help="bake frames again that are up to date")
    existing.add_argument(
        "--only-missing", action="store_true", help="leave every whole frame as it is, also those that are out of date"
    )
    bake.add_argument(
        "--share", type=number(0, 86400, above=True), nargs="?", const=PATIENCE, default=0.0, metavar="SECONDS",
        help="others bake into DIR at the same time: no frame is rendered twice, and one whose process gave no sign of "
        f"life for so long is taken over (default: {PATIENCE:g} seconds)",
    )  # fmt: skip
    bake.add_argument(
        "--dask", metavar="ADDRESS",
        help="bake on the workers of this Dask scheduler, such as tcp://farm:8786, which share DIR (implies --share)",
    )  # fmt: skip
    bake.add_argument(
        "--chunk", type=whole(1, 10**6), default=20, metavar="N", help="frames of one task with --dask (default: 20)"
    )
    for name, words in (("motion-blur", "what moves"), ("depth-of-field", "what is out of focus")):
        bake.add_argument(
            f"--{name}", choices=BLURS, default="shot", help=f"blur {words} (default: shot, as the shot has it)"
        )
    bake.add_argument(
        "--blur-samples", type=whole(1, MOST_BLUR_SAMPLES), metavar="N",
        help="rays a pixel of blurred frames (default: the shot's)",
    )  # fmt: skip
    bake.add_argument(
        "--passes", type=name_list, default=list(DEFAULT_PASSES.names), metavar="A,B,…",
        help=f"of {', '.join(PASSES)} (default: {', '.join(DEFAULT_PASSES.names)}; combined always)",
    )  # fmt: skip

    add_detach(bake)

    trade = add("trade", "measure what speed costs with a model, and find the best settings", long=True)
    trade.add_argument("--model", type=Path, required=True, metavar="FILE")
    _add_sources(trade, "views that training did not see; repeat it to measure on several")
    trade.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for trade.json and trade.png")
    trade.add_argument("--full", action="store_true", help="every value of every setting (default: some, 3 minutes)")
    trade.add_argument("--minutes", type=number(0, above=True), metavar="M", help="how long to measure")
    trade.add_argument(
        "--seconds-per-frame", type=number(0, above=True), metavar="S", help="find the most accurate within this time"
    )
    trade.add_argument("--psnr", type=number(0, above=True), metavar="DB", help="find the fastest above this quality")
    trade.add_argument("--save-preset", metavar="NAME", help="save what was found as a preset of yours")
    trade.add_argument("--no-save", action="store_true", help="leave the model file as it is")

    estimate = add("estimate", "say what baking a shot will take on this computer", long=True)
    estimate.add_argument("--model", type=Path, required=True, metavar="FILE")
    estimate.add_argument("--shot", type=Path, metavar="FILE", help="default: the view the model was measured on")
    estimate.add_argument("--frames", type=frame_list, metavar="1-50,60", help="default: all of the shot")
    estimate.add_argument("--preset", default=DEFAULT_PRESET, metavar="P", help=f"to calibrate with; {_PRESET_HELP}")
    estimate.add_argument("--seconds", type=number(0, 600, above=True), default=2.0, metavar="S", help="of calibration")

    add_reproduce(add("reproduce", "make a table of the paper again", long=True))

    farm = add("farm", "write what a farm's manager needs to bake: Flamenco's job type, or a script for Slurm")
    farm.add_argument("manager", choices=MANAGERS)
    farm.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="for Flamenco: scripts, beside the Manager"
    )

    stand_in = add("stand-in", "make meshes of a model's person and objects, for viewports and shadows", long=True)
    stand_in.add_argument("--model", type=Path, required=True, metavar="FILE")
    stand_in.add_argument("--person", metavar="P", help="default: none, the objects alone")
    stand_in.add_argument("--objects", type=name_list, default=(), metavar="A,B,…", help="default: none")
    stand_in.add_argument("--out", type=Path, required=True, metavar="FILE", help="NAME.npz, see docs/file-formats.md")
    stand_in.add_argument(
        "--voxel", type=number(0.001, 0.2), default=0.01, metavar="M", help="how fine the meshes are, metres"
    )
    stand_in.add_argument("--faces", type=whole(100, 10**8), metavar="N", help="triangles of each mesh at most")

    served = add("serve", "stay up and render poses that come in on standard input (for the add-on's previews)")
    served.add_argument("--model", type=Path, required=True, metavar="FILE")
    served.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help=DEVICE_HELP)

    jobs = add("jobs", "say how far the jobs of a folder are that were started with --detach")
    jobs.add_argument("folder", type=Path, metavar="DIR", help="the --out of bakes, or of a training")
    jobs.add_argument("--stop", action="store_true", help="end those that run, after their step")

    info = add("info", "show what a model file holds")
    info.add_argument("file", type=Path, metavar="FILE")
    info.add_argument("--json", action="store_true", help="as JSON")

    check = add("check-data", "show whether a capture is understood")
    check.add_argument("data", type=Path, metavar="DIR")
    check.add_argument("--format", default="auto", metavar="F")
    check.add_argument("--out", type=Path, metavar="DIR", help="folder for pictures of what was understood")
    check.add_argument("--brief", action="store_true", help="only say what it holds, without opening an image")
    add_progress(check)
    _add_body_model(check)
    check.add_argument("--json", type=Path, metavar="FILE", help="the measurements")

    doctor = add("doctor", "check what this computer has for the work")
    doctor.add_argument("--json", action="store_true", help="as JSON")
    doctor.add_argument(
        "--bundle", type=Path, metavar="FILE.zip",
        help="write what a bug report needs: versions, logs, settings; no pictures, no poses, of paths only names",
    )  # fmt: skip
    doctor.add_argument(
        "--about", type=Path, action="append", default=[], metavar="PATH",
        help="a model, a shot, or the folder of a training or bake, whose logs and headers go along; may be repeated",
    )  # fmt: skip

    demo = add("demo", "make a capture of a character, train it, and bake a shot of it")
    demo.add_argument("--out", type=Path, required=True, metavar="DIR")
    demo.add_argument("--blender-python", type=Path, metavar="PY", help="a Python with the module bpy")
    demo.add_argument("--minutes", type=number(0, above=True), metavar="M", help="how long to train")
    demo.add_argument("--quick", action="store_true", help="small pictures and a short training")
    return parser


def _add_sources(command: argparse.ArgumentParser, several: str) -> None:
    command.add_argument("--data", action=SourceAction, type=Path, metavar="DIR", help=f"a capture; {several}")
    command.add_argument("--format", action=SourceAction, metavar="F", help="its layout (default: auto)")
    command.add_argument("--sequences", action=SourceAction, type=name_list, metavar="A,B,…", help="default: all")
    command.add_argument("--split", action=SourceAction, metavar="FILE:KEY", help="the sequences a JSON file lists")
    command.add_argument("--cameras", action=SourceAction, type=name_list, metavar="A,B,…", help="default: all")
    command.add_argument(
        "--object-size", action=SourceAction, type=number(0, above=True), metavar="M",
        help="metres of the longest side of scanned objects (co3d, transforms; default: 0.5)",
    )  # fmt: skip
    command.add_argument("--image-scale", type=number(0, 1, above=True), default=1.0, metavar="S", help="of the images")
    command.set_defaults(sources=None)
    _add_body_model(command)


def _add_body_model(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--body-model", type=Path, metavar="DIR",
        help="SMPL-H files (default: $CHONA_BODY_MODELS, else a folder smplh beside the data)",
    )  # fmt: skip

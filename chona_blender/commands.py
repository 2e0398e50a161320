"""The add-on without a window: `blender --background scene.blend --command chona …`, or `main([...])` from Python.

Exit codes: 0 done; 1 failed or cancelled; 2 wrong arguments or input, with one line on stderr that says what was
given, what was expected and what to do. Options replace the scene's CHONA settings; the file is saved only by
`--save`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import bpy

from . import actions, capturing, compositing, jobs, measuring, preferences, presets, worker
from .errors import ChonaError
from .frames import parse_frames
from .properties import FORMATS, TRAIN_PRESETS
from .worker_check import check_worker

DONE, FAILED, WRONG = 0, 1, 2


class _Wrong(Exception):
    """Arguments that cannot be understood."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise _Wrong(f"{self.prog}: {message}; see {self.prog} --help")


def main(argv: Sequence[str]) -> int:
    """Run one command on the open scene. What a user can do wrong is told by the exit code and a line on stderr."""
    try:
        arguments = _parser().parse_args(list(argv))
        scene = _scene(arguments.scene)
        _apply(scene, arguments)
        chosen = {key: getattr(arguments, key, None) or "" for key in ("python", "device")}
        with preferences.overridden(**chosen):
            return arguments.run(scene, arguments)
    except SystemExit as leave:  # argparse, after --help
        return int(leave.code or 0)
    except _Wrong as error:
        _say(str(error))
        return WRONG
    except ChonaError as error:
        _say(f"chona: {jobs.sentence(error)}")
        return WRONG


def bake(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """Render the posed actor to EXR frames."""
    started = actions.start_bake(scene)
    for words in started.warnings:
        _say(f"chona: warning: {words}")
    code = _run(started.job)
    if code == DONE and actions.error_words(started.job.result):
        _say(f"chona: {started.job.title}{actions.error_words(started.job.result)}")
    if code == DONE and arguments.composite:
        return composite(scene, arguments)
    return code


def estimate(scene: bpy.types.Scene, _arguments: argparse.Namespace) -> int:
    """Predict the bake with each preset, one line each on stdout."""
    job = measuring.start_estimate(scene)
    code = _run(job)
    if code == DONE:
        sys.stdout.write("\n".join(measuring.keep_estimate(scene, job)) + "\n")
        sys.stdout.flush()
    return code


def composite(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """Put the baked frames into the compositor, or take them out."""
    if getattr(arguments, "remove", False):
        if not actions.remove_composite(scene):
            present = ", ".join(compositing.layer_names(scene)) or "none"
            raise ChonaError(f"the compositor has no layer {scene.chona.name!r}; it has: {present}")
    else:
        result = actions.add_composite(scene)
        for words in result.warnings:
            _say(f"chona: warning: {words}")
        _say(f"chona: composited {result.message}")
    return _save(arguments)


def create_rig(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """Make an armature and empties for a model."""
    names = arguments.objects.split(",") if arguments.objects else None
    _say(f"chona: {actions.make_rig(scene, names)}")
    return _save(arguments)


def train(scene: bpy.types.Scene, _arguments: argparse.Namespace) -> int:
    """Learn a model from captures."""
    return _run(actions.start_train(scene))


def capture(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """Render training data of a rigged character of the scene."""

    def progress(done: int, total: int, message: str) -> None:
        seconds = time.monotonic() - begun
        eta = seconds / done * (total - done) if done else None
        event = {"event": "progress", "job": "capture", "done": done, "total": total, "seconds": seconds, "eta": eta}
        if arguments.progress == "json":
            sys.stdout.write(json.dumps(event | {"message": message}) + "\n")
            sys.stdout.flush()
        else:
            _say(f"chona: capture: {done} of {total}: {message}")

    begun = time.monotonic()
    result = capturing.run_capture(scene, progress)
    for words in result.dropped:
        _say(f"chona: warning: {words} was dropped")
    if arguments.progress == "json":
        event = {"event": "result", "job": "capture", "written": result.rendered, "skipped": result.skipped}
        sys.stdout.write(json.dumps(event) + "\n")
        sys.stdout.flush()
    _say(f"chona: captured {result.rendered} frames, {result.skipped} were there: {result.folder}")
    return DONE


def check(_scene: bpy.types.Scene, _arguments: argparse.Namespace) -> int:
    """Say whether the worker can work."""
    report = check_worker(preferences.worker_python())
    sys.stdout.write(report.text + "\n")
    if not report.good:
        _say(f"chona: {jobs.sentence(ChonaError(report.summary))}")
    return DONE if report.good else WRONG


def _run(job: jobs.Job) -> int:
    """Wait for a job, with a line on stderr for each change worth one."""
    shown = [""]

    def progress(current: jobs.Job) -> None:
        if current.total > 0 and current.text != shown[0]:
            shown[0] = current.text
            _say(f"chona: {current.title}: {current.text}")

    jobs.run_blocking(job, progress)
    if job.status == jobs.DONE:
        _say(f"chona: {job.title}: done")
        return DONE
    _say(f"chona: {job.title}: {jobs.sentence(ChonaError(job.error))}")
    return WRONG if job.code == WRONG else FAILED


def _say(text: str) -> None:
    sys.stderr.write(" ".join(text.split()) + "\n")
    sys.stderr.flush()


def _scene(name: str | None) -> bpy.types.Scene:
    if name is None:
        return bpy.context.scene
    if name not in bpy.data.scenes:
        raise ChonaError(f"there is no scene {name!r}; the file has: {', '.join(bpy.data.scenes.keys())}")
    return bpy.data.scenes[name]


def _apply(scene: bpy.types.Scene, arguments: argparse.Namespace) -> None:
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
        ("overwrite", "overwrite"),
        ("data", "data_folder"),
        ("format", "data_format"),
        ("sequences", "sequences"),
        ("run_folder", "run_folder"),
        ("method", "train_preset"),
        ("minutes", "minutes"),
        ("resume", "resume"),
        *((name, name) for name in CAPTURE_OPTIONS),
    ):
        if option in given:
            setattr(settings, target, str(Path(given[option]).absolute()) if option in PATH_OPTIONS else given[option])
    if "preset" in given:
        settings.preset = presets.check(given["preset"])
    if "armature" in given:
        settings.armature = _object(given["armature"])
    for name in ("capture_armature", "capture_object"):
        if name in given:
            setattr(settings, name, _object(given[name]))
    if "object" in given:
        settings.set_objects(dict(_pair(text) for text in given["object"]))
    if "frames" in given:
        _set_frames(settings, given["frames"])


PATH_OPTIONS = {"model", "out", "data", "run_folder", "capture_folder"}
CAPTURE_OPTIONS = tuple(
    f"capture_{name}" for name in ("person", "sequence", "folder", "cameras", "width", "height", "samples")
)


def _bound(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 0.5:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 0.5")
    return value


def _set_frames(settings: bpy.types.PropertyGroup, text: str) -> None:
    numbers = parse_frames(text)
    step = numbers[1] - numbers[0] if len(numbers) > 1 else 1
    if numbers != list(range(numbers[0], numbers[-1] + 1, step)):
        raise ChonaError(f"frames {text!r} are not one range with one step; run the command once for each range")
    settings.use_scene_range = False
    settings.frame_start, settings.frame_end, settings.frame_step = numbers[0], numbers[-1], step


def _object(name: str) -> bpy.types.Object:
    if name not in bpy.data.objects:
        raise ChonaError(f"there is no object {name!r} in the file; check its name in the outliner")
    return bpy.data.objects[name]


def _pair(text: str) -> tuple[str, bpy.types.Object]:
    name, equals, empty = text.partition("=")
    if not equals:
        raise ChonaError(f"--object {text!r} has no '='; write --object NAME_IN_THE_MODEL=EMPTY")
    return name, _object(empty)


def _save(arguments: argparse.Namespace) -> int:
    if arguments.save is not None:
        target = arguments.save or bpy.data.filepath
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(Path(target).absolute()), check_existing=False)
        except RuntimeError as error:
            raise ChonaError(f"the file {target} cannot be saved: {error}") from error
    return DONE


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="chona", description="CHONA in Blender, without a window.")
    commands = parser.add_subparsers(dest="command", required=True, parser_class=_Parser)

    def add(name: str, run: object, words: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=words, description=words)
        command.set_defaults(run=run, save=None)
        command.add_argument("--scene", metavar="NAME", help="scene to work on (default: the file's active one)")
        return command

    def actor(command: argparse.ArgumentParser) -> None:
        command.add_argument("--model", metavar="FILE", help="model file (.safetensors)")
        command.add_argument("--person", metavar="NAME", help="person of the model; '' for objects alone")

    def layer(command: argparse.ArgumentParser) -> None:
        command.add_argument("--out", metavar="FOLDER", help="folder of the baked frames")
        command.add_argument("--name", metavar="NAME", help="name of the bake; frames are NAME_0001.exr …")

    def python(command: argparse.ArgumentParser) -> None:
        origin = f"the preferences', ${worker.PYTHON_VARIABLE}, .venv beside the sources"
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

    def shot(command: argparse.ArgumentParser) -> None:
        actor(command)
        command.add_argument("--armature", metavar="OBJECT", help="armature object that poses the person")
        command.add_argument(
            "--object", action="append", metavar="NAME=EMPTY",
            help="object of the model and what moves it; repeat for more",
        )  # fmt: skip
        command.add_argument("--frames", metavar="A-B[:STEP]", help="frames to bake (default: the settings')")
        command.add_argument("--preset", metavar="NAME", help=f"{', '.join(presets.OWN)}, or one of your own")
        python(command)

    one = add("bake", bake, "Render the posed actor to EXR frames.")
    shot(one)
    layer(one)
    save(one)
    one.add_argument("--max-error", type=_bound, metavar="E", help="render pixels finer until they change by no more")
    one.add_argument("--overwrite", action="store_const", const=True, help="bake frames again that are up to date")
    one.add_argument("--composite", action="store_true", help="put the frames into the compositor when done")

    shot(add("estimate", estimate, "Predict the bake with each preset after timing this computer for two seconds."))

    one = add("composite", composite, "Put baked frames into the scene's compositor by depth.")
    layer(one)
    save(one)
    one.add_argument("--remove", action="store_true", help="take them out instead")

    one = add("create-rig", create_rig, "Make an armature and empties for a model.")
    actor(one)
    save(one)
    one.add_argument("--objects", metavar="A,B", help="objects of the model (default: all)")

    one = add("capture", capture, "Render training data of a rigged character.")
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
    one.add_argument("--progress", choices=["text", "json"], default="text", help="how progress is told")

    one = add("train", train, "Learn a model from captures.")
    python(one)
    one.add_argument("--data", metavar="FOLDER", help="folder with the captures")
    one.add_argument("--format", choices=[item[0] for item in FORMATS], help="layout of the folder")
    one.add_argument("--sequences", metavar="A,B", help="sequences to learn from (default: all)")
    one.add_argument("--run-folder", metavar="FOLDER", help="folder for the model, its log and checkpoints")
    one.add_argument("--method", choices=[item[0] for item in TRAIN_PRESETS], help="which networks")
    one.add_argument("--minutes", type=float, metavar="M", help="how long")
    one.add_argument("--resume", action="store_const", const=True, help="go on from the last checkpoint")

    python(add("check", check, "Say whether the worker can work, and what to do if not."))
    return parser


_registered: list[object] = []


def register() -> None:
    """Make the command known to `blender --command`."""
    _registered.append(bpy.utils.register_cli_command("chona", main))


def unregister() -> None:
    """Take the command away."""
    while _registered:
        bpy.utils.unregister_cli_command(_registered.pop())

"""The add-on without a window: `blender --background scene.blend --command chona …`, or `main([...])` from Python.

Exit codes: 0 done; 1 failed or cancelled; 2 wrong arguments or input, with one line on stderr that says what was
given, what was expected and what to do. Options replace the scene's CHONA settings; the file is saved only by
`--save`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import bpy

from . import (
    actions,
    capture_command,
    compositing,
    learn_command,
    measuring,
    messages,
    preferences,
    standin_command,
    worker_command,
)
from .command_line import Command, WrongArguments, make_parser
from .command_options import apply, chosen_scene
from .command_parts import DONE, WRONG, run, save, say
from .errors import ChonaError
from .shot_job import replaced_words
from .worker_check import check_worker


def main(argv: Sequence[str]) -> int:
    """Run one command on the open scene. What a user can do wrong is told by the exit code and a line on stderr."""
    try:
        arguments = make_parser(RUNS).parse_args(list(argv))
        scene = chosen_scene(arguments.scene)
        apply(scene, arguments)
        chosen = {key: getattr(arguments, key, None) or "" for key in ("python", "device")}
        with preferences.overridden(**chosen):
            return arguments.run(scene, arguments)
    except SystemExit as leave:  # argparse, after --help
        return int(leave.code or 0)
    except WrongArguments as error:
        say(str(error))
        return WRONG
    except ChonaError as error:
        say(f"chona: {messages.sentence(error)}")
        return WRONG


def bake(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """Render the posed actor to EXR frames."""
    started = actions.start_bake(scene, composite=arguments.composite)
    for words in started.warnings:
        say(f"chona: warning: {words}")
    code = run(started.job)
    if replaced_words(started.job.result):
        say(f"chona: warning: {replaced_words(started.job.result)}")
    if code == DONE and actions.error_words(started.job.result):
        say(f"chona: {started.job.title}{actions.error_words(started.job.result)}")
    if code == DONE and arguments.composite:
        return composite(scene, arguments)
    return code


def shot(scene: bpy.types.Scene, _arguments: argparse.Namespace) -> int:
    """Write the shot that a bake would render; its file on stdout."""
    path, warnings = actions.write_shot(scene)
    for words in warnings:
        say(f"chona: warning: {words}")
    sys.stdout.write(f"{path}\n")
    sys.stdout.flush()
    return DONE


def estimate(scene: bpy.types.Scene, _arguments: argparse.Namespace) -> int:
    """Predict the bake with each preset, one line each on stdout."""
    job = measuring.start_estimate(scene)
    code = run(job)
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
            say(f"chona: warning: {words}")
        say(f"chona: composited {result.message}")
    return save(arguments)


def create_rig(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """Make an armature and empties for a model."""
    names = arguments.objects.split(",") if arguments.objects else None
    say(f"chona: {actions.make_rig(scene, names)}")
    return save(arguments)


def check(_scene: bpy.types.Scene, _arguments: argparse.Namespace) -> int:
    """Say whether the worker can work."""
    report = check_worker(preferences.worker_python(), device=preferences.device())
    sys.stdout.write(report.text + "\n")
    if not report.good:
        say(f"chona: {messages.sentence(ChonaError(report.summary))}")
    return DONE if report.good else WRONG


RUNS: dict[str, Command] = {
    "bake": bake,
    "shot": shot,
    "estimate": estimate,
    "composite": composite,
    "create-rig": create_rig,
    "check": check,
    **capture_command.RUNS,
    **learn_command.RUNS,
    **standin_command.RUNS,
    **worker_command.RUNS,
}
_registered: list[object] = []


def register() -> None:
    """Make the command known to `blender --command`."""
    _registered.append(bpy.utils.register_cli_command("chona", main))


def unregister() -> None:
    """Take the command away."""
    while _registered:
        bpy.utils.unregister_cli_command(_registered.pop())

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

import bpy

from . import actions, capturing, compositing, jobs, measuring, preferences, standin_command
from .command_line import Command, WrongArguments, make_parser
from .command_options import apply, chosen_scene
from .errors import ChonaError
from .worker_check import check_worker

DONE, FAILED, WRONG = 0, 1, 2


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
        _say(str(error))
        return WRONG
    except ChonaError as error:
        _say(f"chona: {jobs.sentence(error)}")
        return WRONG


def bake(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """Render the posed actor to EXR frames."""
    started = actions.start_bake(scene, composite=arguments.composite)
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


def _save(arguments: argparse.Namespace) -> int:
    if arguments.save is not None:
        target = arguments.save or bpy.data.filepath
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(Path(target).absolute()), check_existing=False)
        except RuntimeError as error:
            raise ChonaError(f"the file {target} cannot be saved: {error}") from error
    return DONE


RUNS: dict[str, Command] = {
    "bake": bake,
    "estimate": estimate,
    "composite": composite,
    "create-rig": create_rig,
    "capture": capture,
    "train": train,
    **standin_command.RUNS,
    "check": check,
}
_registered: list[object] = []


def register() -> None:
    """Make the command known to `blender --command`."""
    _registered.append(bpy.utils.register_cli_command("chona", main))


def unregister() -> None:
    """Take the command away."""
    while _registered:
        bpy.utils.unregister_cli_command(_registered.pop())

"""`chona setup-worker` and `chona remove-worker` for `blender --command`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import bpy

from . import jobs, messages, preferences, worker_home, worker_setup
from .errors import ChonaError

DONE, FAILED, WRONG = 0, 1, 2


def add_options(add: Callable[[str, str], argparse.ArgumentParser]) -> None:
    """Describe both commands to the parser of `command_line`."""
    one = add("setup-worker", "Make the worker's Python environment; needs --online-mode or --wheels.")
    builds = [item[0] for item in preferences.BUILDS]
    one.add_argument("--device", dest="build", choices=builds, default="cpu", help="build of torch (default: cpu)")
    one.add_argument(
        "--python", dest="base_python", default="", metavar="FILE",
        help="Python 3.11 or newer to make it of (default: Blender's own, else the first good one of the system)",
    )  # fmt: skip
    one.add_argument(
        "--wheels", default="", metavar="FOLDER", help="install from a folder of wheels, without the network"
    )
    one.add_argument("--torch-index", default="", metavar="URL", help="where torch comes from (default: PyTorch's own)")
    add("remove-worker", "Delete the worker's environment and what interrupted set-ups have left.")


def set_up(_scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """0 set up; 1 failed or cancelled; 2 it cannot start."""
    choice = worker_setup.Choice(arguments.build, arguments.base_python, arguments.wheels, arguments.torch_index)
    _say("\n".join(worker_setup.outlook(choice).lines))
    job = worker_setup.start(choice)
    shown = [""]

    def progress(current: jobs.Job) -> None:
        if current.words != shown[0]:
            shown[0] = current.words
            _say(f"chona: {current.words}")

    jobs.run_blocking(job, progress)
    try:
        if job.status != jobs.DONE:
            raise ChonaError(job.error)
        report = worker_setup.finish(choice, job)
    except ChonaError as error:
        _say(f"chona: {messages.sentence(error)}")
        return WRONG if job.code == WRONG else FAILED
    sys.stdout.write(report.text + "\n")
    sys.stdout.flush()
    return DONE


def remove(_scene: bpy.types.Scene, _arguments: argparse.Namespace) -> int:
    """0 also where there was nothing."""
    freed = worker_home.remove()
    worker_setup.refresh()
    _say(f"chona: {worker_setup.size_words(freed)} are free again")
    return DONE


RUNS = {"setup-worker": set_up, "remove-worker": remove}


def _say(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()

"""`chona train` and `chona check-data` for `blender --command`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import bpy

from . import train_data, train_queue
from .command_parts import DONE, FAILED, run
from .train_properties import FORMATS


def add_options(
    add: Callable[[str, str], argparse.ArgumentParser], python: Callable[[argparse.ArgumentParser], None]
) -> None:
    """Describe `check-data` to the parser of `command_line`; `python` adds the worker's options."""
    one = add("check-data", "Say what a folder with captures holds, and whether it is understood.")
    python(one)
    one.add_argument("--data", metavar="FOLDER", help="folder with the captures")
    one.add_argument("--format", choices=[item[0] for item in FORMATS], help="layout of the folder")
    one.add_argument("--pictures", default="", metavar="FOLDER", help="where the pictures go (default: nowhere)")


def train(scene: bpy.types.Scene, _arguments: argparse.Namespace) -> int:
    """0 trained; 1 failed or stopped, with a checkpoint; 2 it cannot start, or the data cannot be used."""
    row = train_queue.add(scene)
    row.preview, row.detach = 0.0, False  # nobody looks, and the command's end is waited for
    return run(train_queue.start(row))


def check_data(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """0 the data look right; 1 they do not, and why; 2 they cannot be read."""
    job = train_data.start_check(scene, arguments.pictures)
    code = run(job)
    if code != DONE:
        return code
    found = train_data.keep(job)
    lines = [found.headline, *(f"warning: {words}" for words in found.warnings)]
    lines += [str(each.sheet) for each in found.sequences if each.sheet is not None and arguments.pictures]
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()
    return DONE if found.sound else FAILED


RUNS = {"train": train, "check-data": check_data}

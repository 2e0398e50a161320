"""What commands without a window share: exit codes, a line on stderr, and waiting for a job."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy

from . import jobs, messages
from .errors import ChonaError

DONE, FAILED, WRONG = 0, 1, 2


def run(job: jobs.Job) -> int:
    """Wait for a job, with a line on stderr for each change worth one; returns an exit code."""
    shown = [""]

    def progress(current: jobs.Job) -> None:
        if current.total > 0 and current.text != shown[0]:
            shown[0] = current.text
            say(f"chona: {current.title}: {current.text}")

    jobs.run_blocking(job, progress)
    if job.status == jobs.DONE:
        say(f"chona: {job.title}: done")
        return DONE
    say(f"chona: {job.title}: {messages.sentence(ChonaError(job.error))}")
    return WRONG if job.code == WRONG else FAILED


def save(arguments: argparse.Namespace) -> int:
    """Save the file where `--save` was given, under its name or the open file's; returns an exit code."""
    if arguments.save is not None:
        target = arguments.save or bpy.data.filepath
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(Path(target).absolute()), check_existing=False)
        except RuntimeError as error:
            raise ChonaError(f"the file {target} cannot be saved: {error}") from error
    return DONE


def say(text: str) -> None:
    """A line on stderr."""
    sys.stderr.write(" ".join(text.split()) + "\n")
    sys.stderr.flush()

"""``--detach``: a command goes on in a process of its own, which ends with nobody; ``chona jobs`` says how far."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import chona_model
from chona_model.arguments import UsageError, writable_folder
from chona_model.command_parts import FAILED, finish
from chona_model.formats.folder_lock import FolderBusyError
from chona_model.formats.job_file import bake_file, is_running, job_files, read_job, train_file
from chona_model.launch import read_launch
from chona_model.progress import Progress

OPTION = "--detach"
BEGIN_SECONDS = 60.0
"""Longest time until a process says that it has begun."""


def start_detached(words: Sequence[str], arguments: argparse.Namespace, progress: Progress) -> int:
    """Starts the command of ``words`` again, without ``--detach``, and waits until it has begun; an exit code.

    Raises:
        UsageError: torchrun has started this, or it is to end with its parent.  ShotError: the shot of a bake cannot be
            read.  FolderBusyError: the same runs already.
    """
    if read_launch().size > 1:
        raise UsageError(f"{OPTION} is given, but torchrun has started this process: detach torchrun itself")
    if arguments.until_closed:
        raise UsageError(f"both {OPTION} and --until-closed are given, to end with nobody and with whoever started it")
    out = writable_folder(arguments.out.absolute(), "--out")
    path = bake_file(out, _shot_name(arguments.shot)) if arguments.command == "bake" else train_file(out)
    if is_running(path):
        raise FolderBusyError(f"{path} is of a job that runs already; wait, or create {path.stem}.stop there to end it")
    rest = [word for word in words if word != OPTION]
    with path.with_suffix(".log").open("ab") as log:
        child = subprocess.Popen(
            [sys.executable, "-m", "chona_model", *rest, "--progress-file", str(path)],
            stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=_environment(), **_own_session(),
        )  # fmt: skip
    until = time.monotonic() + BEGIN_SECONDS
    while child.poll() is None and _pid_in(path) != child.pid and time.monotonic() < until:
        time.sleep(0.05)
    if child.poll() is not None and _pid_in(path) != child.pid:
        said = path.with_suffix(".log").read_text("utf-8", "replace").splitlines()
        progress.error((said or ["the process ended before it began"])[-1].removeprefix("chona: "), child.returncode)
        return child.returncode if child.returncode > 0 else FAILED
    stop = path.with_suffix(".stop")
    return finish(
        progress, f"process {child.pid} goes on by itself; 'chona jobs {out}' says how far it is, with --stop it ends",
        pid=child.pid, file=str(path), stop=str(stop),
    )  # fmt: skip


def describe_jobs(folder: Path, stop: bool) -> list[str]:
    """A line for every job that was left in a folder.

    Args:
        stop: ask those that run to end after their step.

    Raises:
        UsageError: there is none.
    """
    found = [(path, content) for path in job_files(folder) if (content := read_job(path)) is not None]
    if not found:
        raise UsageError(f"{folder} holds no job of --detach; expected the --out of a bake or a training")
    lines = []
    for path, content in found:
        runs = is_running(path)
        if runs and stop:
            path.with_suffix(".stop").touch()
        lines.append(_sentence(path, content, runs, stop))
    return lines


def _sentence(path: Path, content: dict[str, Any], runs: bool, asked: bool) -> str:
    name = path.stem.removeprefix(".chona-").replace("-", " ", 1)
    told, end, owner = content["progress"] or content["start"] or {}, content["end"], content["owner"]
    done = f"{told.get('done') or 0:g} of {told.get('total') or 0:g}" if told else "it has not begun"
    if runs:
        left = f", {told['eta']:.0f} s left" if told.get("eta") is not None else ""
        who = f"process {owner['pid']} on {owner['host']} since {content['since']}"
        return f"{name}: {done}{left}; {who}{'; it ends after its step' if asked else ''}"
    if end is None:
        return f"{name}: killed after {content['written']}, {done}; the same command goes on"
    words = {"result": "done", "cancelled": f"cancelled, {done}"}.get(end["event"], f"failed: {end.get('message')}")
    return f"{name}: {words}; {content['written']}"


def _shot_name(path: Path) -> str:
    from chona_model.formats.shot import read_shot

    return read_shot(path).name


def _environment() -> dict[str, str]:
    """This process's; its sources are found also where they are not installed."""
    sources = str(Path(chona_model.__file__).resolve().parents[1])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [sources, os.environ.get("PYTHONPATH")]))}


def _own_session() -> dict[str, Any]:
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}


def _pid_in(path: Path) -> int | None:
    """The process that wrote the file last; None where there is none."""
    content = read_job(path)
    return None if content is None else int(content["owner"]["pid"])

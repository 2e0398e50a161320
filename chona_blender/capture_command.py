"""`chona capture` for `blender --command`: what lies before it, and the capture itself."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import bpy

from . import capturing
from .capture_estimate import CaptureEstimate, size_words
from .command_parts import DONE, FAILED, say
from .jobs import duration


class Stopped(Exception):
    """The user, or a render farm, wants an end."""


def add_options(command: argparse.ArgumentParser) -> None:
    """Describe what came after the first version to the parser of `command_line`."""
    command.add_argument("--capture-rings", type=int, metavar="N", help="rings, one above the other")
    command.add_argument("--capture-radius", type=float, metavar="M", help="of the rings, metres; 0 fits it")
    command.add_argument("--capture-ring-height", type=float, metavar="M", help="of the rings over the performance")
    command.add_argument("--capture-ring-spacing", type=float, metavar="M", help="from one ring to the next")
    command.add_argument("--capture-lens", type=float, metavar="MM", help="focal length on a sensor of 36 mm")
    command.add_argument("--estimate", action="store_true", help="only say what it will take, after two images")


def capture(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """0 captured or estimated; 1 stopped, whole frames are kept; 2 it cannot be captured."""
    tell = _event if arguments.progress == "json" else _nothing
    if arguments.estimate:
        found = capturing.run_estimate(scene)
        words = estimate_words(found)
        tell("result", words=words, images=found.images, **asdict(found))
        for each in found.warnings:
            say(f"chona: warning: {each}")
        say(f"chona: capture: {words}")
        return DONE
    begun, first = time.monotonic(), [-1]

    def progress(done: int, total: int, message: str) -> None:
        if first[0] < 0:
            first[0] = done - 1
        seconds = time.monotonic() - begun
        eta = seconds / (done - first[0]) * (total - done)
        tell("progress", done=done, total=total, seconds=seconds, eta=eta, message=message)
        if arguments.progress != "json":
            say(f"chona: capture: {done} of {total}, {duration(eta)} left: {message}")
        if stop.is_set():
            raise Stopped

    with _asked_to_stop() as stop:
        try:
            result = capturing.run_capture(scene, progress)
        except Stopped:
            tell("cancelled")
            say("chona: capture was stopped; whole frames are kept, and the same command goes on from there")
            return FAILED
    for words in (*(f"{each} was dropped" for each in result.dropped), *result.warnings):
        say(f"chona: warning: {words}")
    tell("result", written=result.rendered, skipped=result.skipped, warnings=list(result.warnings))
    say(f"chona: captured {result.rendered} frames, {result.skipped} were there: {result.folder}")
    return DONE


def estimate_words(found: CaptureEstimate) -> str:
    """`400 images, about 12 min 05 s and 84 MB`."""
    if not found.images:
        return "all frames are there"
    there = f" ({found.finished} of {found.frames} frames are there)" if found.finished else ""
    images = f"{found.images} image{'s' * (found.images != 1)}"
    return f"{images}{there}, about {duration(found.seconds)} and {size_words(found.bytes)}"


RUNS = {"capture": capture}


def _event(kind: str, **fields: Any) -> None:
    sys.stdout.write(json.dumps({"event": kind, "job": "capture", **fields}) + "\n")
    sys.stdout.flush()


def _nothing(kind: str, **fields: Any) -> None:
    pass


@contextmanager
def _asked_to_stop() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set; the image that is being rendered is finished first."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    names = (signal.SIGINT, signal.SIGTERM)
    before: list[Callable | int | None] = [signal.signal(name, lambda *_: asked.set()) for name in names]
    try:
        yield asked
    finally:
        for name, handler in zip(names, before, strict=True):
            signal.signal(name, handler if handler is not None else signal.SIG_DFL)

"""Compiles jobs of our Flamenco job type and runs their commands, as a Manager and a Worker do."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from farm_scene import ENVIRONMENT, ROOT

JOB_TYPE_FILE = ROOT / "chona_model" / "farm" / "chona_bake.js"
GLOBALS_FILE = Path(__file__).with_name("flamenco_globals.js")


class Refused(Exception):
    """The job type threw this."""


class Manager:
    """Our job type in an engine of ECMAScript 5.1."""

    def __init__(self) -> None:
        import dukpy

        self._engine = dukpy.JSInterpreter()
        self._engine.evaljs([GLOBALS_FILE.read_text("utf-8"), JOB_TYPE_FILE.read_text("utf-8"), "null"])
        self.job_type: dict[str, Any] = self._engine.evaljs("JOB_TYPE")

    def compile(self, settings: Mapping[str, Any]) -> list[dict[str, Any]]:
        """The job's tasks; ``Refused`` with the words that the user sees."""
        answer = self._engine.evaljs(
            "(function () { try { return { tasks: compiled(dukpy.settings) }; }"
            " catch (error) { return { error: String(error) }; } })()",
            settings=dict(settings),
        )
        if "error" in answer:
            raise Refused(answer["error"])
        return answer["tasks"]

    def chunks(self, frames: str, size: int, ours: bool) -> list[str]:
        """Frames in chunks, by the job type or by the Manager's own function."""
        script = (
            "chunksOf(frameNumbers(dukpy.frames), dukpy.size)" if ours else "frameChunker(dukpy.frames, dukpy.size)"
        )
        return self._engine.evaljs(script, frames=frames, size=size)

    def defaults(self) -> dict[str, Any]:
        """What the submit panel shows before anything is typed or evaluated."""
        return {setting["key"]: setting["default"] for setting in self.job_type["settings"] if "default" in setting}


def in_order(tasks: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Tasks of which every dependency was yielded before; anything else is an error."""
    for place, task in enumerate(tasks):
        assert all(0 <= earlier < place for earlier in task["dependencies"]), task
        yield task


def run_task(task: Mapping[str, Any], variables: Mapping[str, str], **environment: str) -> list[list[str]]:
    """Runs a task's commands as the Worker does, without a shell; what was run. Raises where one fails."""
    done = []
    for command in task["commands"]:
        words = command_line(command, variables)
        result = subprocess.run(
            words, env=ENVIRONMENT | environment, capture_output=True, text=True, check=False, timeout=300
        )
        assert result.returncode == 0, (words, result.stdout[-2000:], result.stderr[-2000:])
        done.append(words)
    return done


def command_line(command: Mapping[str, Any], variables: Mapping[str, str]) -> list[str]:
    """As the Worker puts it together, variables replaced: ``exec``, ``blender-render`` and ``frames-to-video``."""
    given = json.loads(
        json.dumps(command["parameters"]),
        object_hook=lambda found: {key: _filled(found[key], variables) for key in found},
    )
    before = [*given.get("exeArgs", "").split(), *given.get("argsBefore", [])]
    match command["name"]:
        case "exec":
            return [given["exe"], *given["args"]]
        case "blender-render":
            return [given["exe"], *before, given["blendfile"], *given["args"]]
        case "frames-to-video":
            rate = f"{given['fps']:g}"
            exe = variables.get(given["exe"], given["exe"])  # the Worker finds ffmpeg itself
            source = ["-r", rate, "-pattern_type", "glob", "-i", given["inputGlob"]]
            return [exe, *before, *source, *given["args"], "-r", rate, given["outputFile"]]
    raise AssertionError(f"the Worker knows no command {command['name']}")


def _filled(value: Any, variables: Mapping[str, str]) -> Any:
    if isinstance(value, list):
        return [_filled(item, variables) for item in value]
    if isinstance(value, str):
        return re.sub(r"{(\w+)}", lambda found: variables.get(found[1], found[0]), value)
    return value


def find_ffmpeg() -> str | None:
    """The program, of the system or of the package imageio-ffmpeg."""
    from shutil import which

    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        return which("ffmpeg")
    return which("ffmpeg") or os.fspath(get_ffmpeg_exe())

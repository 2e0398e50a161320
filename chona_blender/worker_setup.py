"""Sets up the worker's environment: which Python it is made of, what goes into it, how big that is, and the job.

The work is done by `worker_setup_process` in that Python; here it is prepared, judged and put in its place.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import bpy

from . import jobs, worker_home, worker_setup_process
from .errors import ChonaError
from .events import need
from .worker import Worker, sources_folder
from .worker_check import OLDEST, WorkerReport, judge, probe_arguments
from .worker_packages import TORCH_INDEX, Package, Size, constraints, measured_size, packages

NAMES = ("python3.13", "python3.12", "python3.11", "python3.14", "python3", "python")
PROBE = """
import json, sys
lacks = []
for name in ("venv", "ensurepip"):
    try:
        __import__(name)
    except ImportError:
        lacks.append(name)
base = {"path": sys.executable or "", "version": list(sys.version_info[:3]), "lacks": lacks}
print(json.dumps({"event": "result", "job": "probe", "base": base}))
"""
PROBE_SECONDS = 30.0


@dataclass(frozen=True)
class Base:
    """A Python that an environment may be made of. `problem` is empty when it can be."""

    path: Path
    version: str = ""
    problem: str = ""

    @property
    def words(self) -> str:
        return f"{self.path}: {self.problem}" if self.problem else f"Python {self.version}, {self.path}"


@dataclass(frozen=True)
class Choice:
    """What the user chooses: `cpu` or `cuda`; a Python ("" finds one); a folder of wheels; an index for torch."""

    device: str = "cpu"
    python: str = ""
    wheels: str = ""
    torch_index: str = ""


@dataclass(frozen=True)
class Outlook:
    """What a set-up would do, told before it starts. `problem` says why it cannot start."""

    choice: Choice
    folder: Path
    packages: tuple[Package, ...]
    base: Base
    size: Size | None
    free: int
    problem: str = ""

    @property
    def needed(self) -> int:
        """Bytes that must be free: the wheels, and what they become; 0 where nobody has measured that."""
        if self.size is None:
            return 0
        return self.size.installed + (0 if self.choice.wheels else self.size.download)

    @property
    def lines(self) -> list[str]:
        """For the dialog and for a terminal."""
        roots = ", ".join(f"{each.name} {each.pinned}" for each in self.packages)
        count = "" if self.size is None else f", {self.size.packages} packages in all"
        found = [f"Installs {roots} and what they need{count}"]
        if self.choice.wheels:
            found.append(f"From the wheels in {self.choice.wheels}, without the network")
        else:
            index = self.choice.torch_index or TORCH_INDEX[self.choice.device]
            found.append(f"From pypi.org, torch from {index}; or from where pip is configured to look")
        if self.size is None:
            found.append("How big that is has not been measured on this system")
        else:
            download = "" if self.choice.wheels else f"{size_words(self.size.download)} to download, "
            found.append(f"{download}{size_words(self.size.installed)} on the disk, {size_words(self.free)} are free")
        found.append(f"Into {self.folder}")
        found.append(f"With {self.base.words}")
        return found


def size_words(count: float) -> str:
    """`1234567890` -> `1.2 GB`, `12345678` -> `12 MB`."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def outlook(choice: Choice) -> Outlook:
    """Look at everything that a set-up needs, without the network. Takes a second or two where Pythons are searched.

    Raises:
        ChonaError: the extension's own files are not whole.
    """
    home, sources = worker_home.folder(), sources_folder()
    base = find_base(choice.python)
    found = Outlook(choice, home, packages(sources), base, measured_size(choice.device), worker_home.free_bytes(home))
    return Outlook(**{**found.__dict__, "problem": _problem(found)})


def _problem(found: Outlook) -> str:
    choice = found.choice
    if found.base.problem:
        return f"{found.base.words}; choose another Python"
    if choice.wheels and not Path(choice.wheels).is_dir():
        return f"there is no folder {choice.wheels}; choose the folder of wheels again"
    if not choice.wheels and not bpy.app.online_access:
        return offline_words()
    if choice.device == "cuda" and sys.platform == "darwin":
        return "there is no CUDA on macOS; choose CPU"
    if not worker_home.writable(found.folder):
        return f"{found.folder} cannot be written to; allow writing there, or set BLENDER_USER_RESOURCES"
    if found.needed > found.free:
        return (
            f"{size_words(found.needed)} are needed on the disk of {found.folder}, {size_words(found.free)} are free; "
            "free some space, or set BLENDER_USER_RESOURCES to a folder on another disk"
        )
    return ""


def offline_words() -> str:
    """Why nothing is downloaded, and what to do."""
    if bpy.app.online_access_override:
        return (
            "Blender was started without online access; start it with --online-mode, or set up from a folder of wheels"
        )
    return (
        "Blender's online access is off; allow it in Preferences ▸ System ▸ Network, start Blender with --online-mode, "
        "or set up from a folder of wheels"
    )


def find_base(named: str = "") -> Base:
    """The Python to make the environment of: the named one, else Blender's own, else the first good one of the system.

    Where none is good, Blender's own comes back with what it lacks.
    """
    if named:
        return examine(named)
    own = examine(sys.executable)
    if not own.problem:
        return own
    others = (examine(path) for path in _system_pythons())
    return next((each for each in others if not each.problem), own)


@cache
def examine(path: str) -> Base:
    """Whether environments can be made of a Python. Asked once a session: it starts a process."""
    try:
        worker = Worker([path, "-I", "-c", PROBE])
    except ChonaError:
        return Base(Path(path), problem="does not start as a Python")
    try:
        worker.wait(PROBE_SECONDS)
        answer = next((event["base"] for event in worker.events() if "base" in event), None)
    finally:
        worker.close(grace=0.0)
    if answer is None:
        return Base(Path(path), problem="does not start as a Python")
    version = ".".join(map(str, answer["version"]))
    problem = ""
    if tuple(answer["version"][:2]) < OLDEST:
        problem = f"is Python {version}, expected {'.'.join(map(str, OLDEST))} or newer"
    elif answer["lacks"]:
        debian = "; on Debian and Ubuntu the package python3-venv has them" if sys.platform == "linux" else ""
        problem = f"cannot make environments, it lacks {' and '.join(answer['lacks'])}{debian}"
    return Base(Path(answer["path"] or path), version, problem)


def _system_pythons() -> Iterator[str]:
    """Pythons on PATH and where installers put them: programs started from a desktop often have a short PATH."""
    places = [os.environ.get("PATH", ""), "/usr/local/bin", "/opt/homebrew/bin"]
    search = os.pathsep.join(place for place in places if place)
    seen = {sys.executable}
    windows = Path(os.environ.get("LOCALAPPDATA", "")) / "Programs" / "Python"
    installed = sorted(map(str, windows.glob("Python3*/python.exe")), reverse=True) if sys.platform == "win32" else []
    for path in [*(shutil.which(name, path=search) for name in NAMES), *installed]:
        if path and path not in seen:
            seen.add(path)
            yield path


class SetUpJob(jobs.Job):
    """A set-up: its words say which package of how many, where other jobs count frames."""

    @property
    def text(self) -> str:
        if self.status != jobs.RUNNING or self.total <= 0:
            return self.words
        if self.total < MEGABYTE:
            return self.words  # packages are counted in the words already
        return f"{self.words}, {size_words(self.done)} of {size_words(self.total)}"


MEGABYTE = 1e6


def start(choice: Choice) -> SetUpJob:
    """Start the set-up in the chosen Python.

    Raises:
        ChonaError: it cannot start; the outlook's `problem`.
    """
    found = outlook(choice)
    if found.problem:
        raise ChonaError(found.problem)
    worker_home.folder(create=True)
    plan = worker_setup_process.Plan(
        folder=str(found.folder),
        requirements=[each.requirement for each in found.packages],
        constraints=str(constraints(sources_folder())),
        torch_index="" if choice.wheels else choice.torch_index or TORCH_INDEX[choice.device],
        torch_index_asked=bool(choice.torch_index),
        wheels=str(Path(choice.wheels).absolute()) if choice.wheels else "",
        probe=probe_arguments(load=True),
        bytes=found.size.wheels if found.size else {},
    )
    script = str(Path(__file__).with_name("worker_setup_process.py"))
    return SetUpJob("Set up worker", [str(found.base.path), "-I", script, json.dumps(asdict(plan))])


def finish(choice: Choice, job: jobs.Job) -> WorkerReport:
    """Judge the new environment and put it in its place.

    Raises:
        ChonaError: it cannot be the worker; what was set up before stays.
    """
    need(job.result, "environment", "check", "bytes")
    environment = Path(job.result["environment"])
    python = worker_setup_process.environment_python(environment)
    report = judge(python, "the new environment", job.result["check"], 0, [])
    if not report.good:
        raise ChonaError(report.summary)
    if choice.device == "cuda" and not job.result["check"].get("torch_cuda"):
        raise ChonaError(
            f"the torch that was installed ({report.details['torch']}) is a build for the CPU alone; "
            "name an index that has builds with CUDA, or set up with CPU"
        )
    facts = worker_home.Ready(
        device=choice.device,
        torch=report.details["torch"],
        python=job.worker.command[0],
        version=report.details.get("chona_model", ""),
        bytes=job.result["bytes"],
    )
    place = worker_home.adopt(environment, facts)
    refresh()
    return judge(place, ORIGIN, job.result["check"] | {"executable": str(place)}, 0, [])


ORIGIN = "Set Up Worker"


class _Known:
    """What the panels show: read when something changes, never while drawing."""

    ready: worker_home.Ready | None = None


def refresh() -> None:
    """Read again whether an environment is set up."""
    _Known.ready = worker_home.ready(worker_home.folder() / worker_home.ENVIRONMENT)


def forget() -> None:
    """Switching off."""
    _Known.ready = None
    examine.cache_clear()


def known() -> worker_home.Ready | None:
    """The environment that was there at the last look."""
    return _Known.ready

"""Says in words whether a Python can be the worker, and what to do when it cannot."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import ChonaError
from .events import PACKAGES
from .worker import Worker, find_python, sources_folder
from .worker_packages import older, packages

OLDEST = (3, 11)
REQUIRED = {
    "torch": "torch",
    "numpy": "numpy",
    "numba": "numba",
    "scipy": "scipy",
    "PIL": "pillow",
    "skimage": "scikit-image",
    "OpenEXR": "OpenEXR",
    "safetensors": "safetensors",
    "msgspec": "msgspec",
    "tqdm": "tqdm",
}

# Runs in the worker's Python, which may be any version: plain old syntax. With "load" every package is imported for
# real, which finds broken installs and takes seconds; without, they are only looked up.
PROBE = """
import json, sys
names, load = json.loads(sys.argv[1]), sys.argv[2] == "load"
found = {"event": "result", "job": "check", "python": list(sys.version_info[:3]), "executable": sys.executable}
found.update(missing=[], broken={}, versions={}, notes=[])
if sys.version_info >= (3, 8):
    import importlib.metadata, importlib.util
    for name, package in names.items():
        if importlib.util.find_spec(name) is None:
            found["missing"].append(name)
            continue
        try:
            found["versions"][package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            pass
        if load:
            try:
                module = __import__(name)
            except Exception as error:
                found["broken"][name] = "%s: %s" % (type(error).__name__, error)
            else:
                if name == "torch":
                    found["torch"], found["torch_cuda"] = str(module.__version__), module.version.cuda
                    found["cuda"] = module.cuda.get_device_name(0) if module.cuda.is_available() else ""
    own = importlib.util.find_spec("chona_model")
    if own is None:
        found["missing"].append("chona_model")
    else:
        found["chona_model"] = own.origin
        if load and not found["missing"] and not found["broken"]:
            from chona_model import doctor
            for check in doctor.surroundings():
                if check.state != "ok":
                    found["notes"].append([check.name, check.found, check.remedy])
print(json.dumps(found))
"""


@dataclass(frozen=True)
class WorkerReport:
    """The result of a check. `problem` is empty when the worker can work; `notes` say what it has to do without."""

    python: Path
    origin: str
    problem: str = ""
    remedy: str = ""
    details: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def good(self) -> bool:
        return not self.problem

    @property
    def summary(self) -> str:
        """One line for a report or a panel."""
        if self.problem:
            return f"{self.problem}; {self.remedy}" if self.remedy else self.problem
        version = ".".join(str(part) for part in self.details.get("python", ()))
        torch = self.details.get("torch")
        if torch is None:
            return f"Python {version}"
        return f"Python {version}, torch {torch}, {self.details.get('cuda') or 'CPU only'}"

    @property
    def text(self) -> str:
        """Everything that was found out, to be copied into a bug report."""
        lines = [f"worker: {self.python}", f"named by: {self.origin}", f"result: {self.summary}"]
        lines += [f"note: {words}" for words in self.notes]
        lines += [f"{key}: {value}" for key, value in self.details.items() if key not in {"event", "job"}]
        return "\n".join(lines)


def probe_arguments(load: bool) -> list[str]:
    """What makes a Python describe itself as one `result` event."""
    return ["-c", PROBE, json.dumps(REQUIRED), "load" if load else "look"]


def probe_command(python: Path, load: bool) -> list[str]:
    """The command line for the worker's Python."""
    return [str(python), *probe_arguments(load)]


def check_worker(
    preference: str = "", load: bool = True, seconds: float = 180.0, device: str = "auto"
) -> WorkerReport:  # fmt: skip
    """Ask the worker's Python about itself, and judge the answer. Never raises: what is wrong is in the report."""
    try:
        python, origin = find_python(preference)
    except ChonaError as error:
        problem, _, remedy = str(error).partition("; ")
        return WorkerReport(Path(preference), "", problem, remedy)
    try:
        sources_folder()
        worker = Worker(probe_command(python, load))
    except ChonaError as error:
        problem, _, remedy = str(error).partition("; ")
        return WorkerReport(python, origin, problem, remedy)
    try:
        worker.wait(seconds)
        events = worker.events()
        return judge(python, origin, events[-1] if events else None, worker.code(), list(worker.lines), device)
    finally:
        worker.close()


def judge(
    python: Path, origin: str, answer: dict[str, Any] | None, code: int | None, lines: list[str], device: str = "auto"
) -> WorkerReport:
    """Turn what the probe answered into words.

    Args:
        device: `cuda` makes a graphics card that cannot be used a problem; else it is a note.
    """
    if answer is not None and not answer.keys() >= PACKAGES.keys():
        answer = None  # it speaks of something else
    problem, remedy, more = _fault(python, answer, code, lines, device)
    if answer is None:
        return WorkerReport(python, origin, problem, remedy, {"output": "\n".join(lines)})
    said = [note for note in answer["notes"] if note[0] != "CUDA" or answer.get("torch_cuda")]  # a CPU build was chosen
    notes = tuple(f"{name}: {found}" + (f"; {what}" if what else "") for name, found, what in said)
    return WorkerReport(python, origin, problem, remedy, answer | more, notes)


def _fault(
    python: Path, answer: dict[str, Any] | None, code: int | None, lines: list[str], device: str
) -> tuple[str, str, dict[str, str]]:
    """What is wrong first, what to do, and more for the report; nothing where all is well."""
    other = "press Set Up Worker, or name another Python in the add-on's preferences"
    if answer is None:
        last = lines[-1] if lines else "it said nothing"
        what = "did not answer in time" if code is None else f"ended with code {code}"
        return f"the worker's Python {python} {what}: {last}", other, {}
    if tuple(answer["python"][:2]) < OLDEST:
        found = ".".join(str(part) for part in answer["python"])
        return f"the worker's Python {python} is {found}; expected 3.11 or newer", other, {}
    missing, broken = answer["missing"], answer["broken"]
    if missing:
        names = " ".join(REQUIRED[name] for name in missing if name in REQUIRED)
        install = {"to install": f"{python} -m pip install {names}"} if names else {}
        more = f" and {len(missing) - 1} more packages" if len(missing) > 1 else ""
        return f"the worker's Python {python} has no {missing[0]}{more}", f"{other} (the report has a command)", install
    if broken:
        name, reason = next(iter(broken.items()))
        remedy = f"reinstall with `{python} -m pip install --force-reinstall {REQUIRED[name]}`, or {other}"
        return f"{name} in the worker's Python {python} does not load ({reason})", remedy, {}
    return *(_old(python, answer, other) or _foreign(python, answer, other) or _no_card(answer, device) or ("", "")), {}


def _old(python: Path, answer: dict[str, Any], other: str) -> tuple[str, str] | None:
    """A package that is older than the worker needs."""
    for each in packages(sources_folder()):
        version = answer["versions"].get(each.name)
        if version is not None and older(version, each.minimum):
            problem = f"{each.name} in the worker's Python {python} is {version}; expected {each.minimum} or newer"
            return problem, f"install {each.requirement} there, or {other}"
    return None


def _foreign(python: Path, answer: dict[str, Any], other: str) -> tuple[str, str] | None:
    """Another chona_model than the add-on's own: a wrapper or a site configuration goes before PYTHONPATH."""
    own = sources_folder() / "chona_model"
    loaded = Path(answer.get("chona_model", "")).parent
    if loaded.resolve() == own.resolve():
        return None
    problem = f"the worker's Python {python} loads chona_model from {loaded}, not the add-on's own, which may be newer"
    return problem, f"uninstall chona-model there, or {other}"


def _no_card(answer: dict[str, Any], device: str) -> tuple[str, str] | None:
    """CUDA was chosen, and cannot be used."""
    if device != "cuda" or answer.get("cuda", "?"):  # a quick look does not ask
        return None
    reason = next((found for name, found, _ in answer["notes"] if name == "CUDA"), "no card answers")
    remedy = "set the device to Automatic or Processor, or press Set Up Worker and choose CUDA"
    return f"the device is CUDA, which cannot be used: {reason}", remedy

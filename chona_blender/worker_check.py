"""Says in words whether a Python can be the worker, and what to do when it cannot."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import ChonaError
from .worker import Worker, find_python, sources_folder

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
# real, which finds broken
# installs and takes seconds; without, they are only looked up.
PROBE = """
import json, sys
names, load = json.loads(sys.argv[1]), sys.argv[2] == "load"
found = {"event": "result", "job": "check", "python": list(sys.version_info[:3]), "executable": sys.executable}
found.update(missing=[], broken={})
if sys.version_info >= (3, 6):
    import importlib.util
    for name in names:
        if importlib.util.find_spec(name) is None:
            found["missing"].append(name)
        elif load:
            try:
                module = __import__(name)
            except Exception as error:
                found["broken"][name] = "%s: %s" % (type(error).__name__, error)
            else:
                if name == "torch":
                    found["torch"] = str(module.__version__)
                    found["cuda"] = module.cuda.get_device_name(0) if module.cuda.is_available() else ""
    if importlib.util.find_spec("chona_model") is None:
        found["missing"].append("chona_model")
print(json.dumps(found))
"""


@dataclass(frozen=True)
class WorkerReport:
    """The result of a check. `problem` is empty when the worker can work."""

    python: Path
    origin: str
    problem: str = ""
    remedy: str = ""
    details: dict[str, Any] = field(default_factory=dict)

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
        lines += [f"{key}: {value}" for key, value in self.details.items() if key not in {"event", "job"}]
        return "\n".join(lines)


def probe_command(python: Path, load: bool) -> list[str]:
    """The command line that makes the worker's Python describe itself as one `result` event."""
    return [str(python), "-c", PROBE, json.dumps(list(REQUIRED)), "load" if load else "look"]


def check_worker(preference: str = "", load: bool = True, seconds: float = 180.0) -> WorkerReport:
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
        return judge(python, origin, events[-1] if events else None, worker.code(), list(worker.lines))
    finally:
        worker.close()


def judge(python: Path, origin: str, answer: dict[str, Any] | None, code: int | None, lines: list[str]) -> WorkerReport:
    """Turn what the probe answered into words."""
    other = "name another Python in the add-on's preferences"
    if answer is None:
        last = lines[-1] if lines else "it said nothing"
        what = "did not answer in time" if code is None else f"ended with code {code}"
        return WorkerReport(
            python, origin, f"the worker's Python {python} {what}: {last}", other, {"output": "\n".join(lines)}
        )
    version = tuple(answer["python"][:2])
    if version < OLDEST:
        found = ".".join(str(part) for part in answer["python"])
        return WorkerReport(
            python, origin, f"the worker's Python {python} is {found}; expected 3.11 or newer", other, answer
        )
    missing, broken = answer["missing"], answer["broken"]
    if missing:
        packages = " ".join(REQUIRED[name] for name in missing if name in REQUIRED)
        install = {"to install": f"{python} -m pip install {packages}"} if packages else {}
        more = f" and {len(missing) - 1} more packages" if len(missing) > 1 else ""
        remedy = f"{other}, or install them (the report has the command)"
        problem = f"the worker's Python {python} has no {missing[0]}{more}"
        return WorkerReport(python, origin, problem, remedy, answer | install)
    if broken:
        name, reason = next(iter(broken.items()))
        remedy = f"reinstall with `{python} -m pip install --force-reinstall {REQUIRED[name]}`, or {other}"
        return WorkerReport(
            python, origin, f"{name} in the worker's Python {python} does not load ({reason})", remedy, answer
        )
    return WorkerReport(python, origin, details=answer)

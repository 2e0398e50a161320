"""What the worker's environment holds: the project's own list with its pinned versions, and how big that is.

`pyproject.toml` and `constraints.txt` travel in the extension beside the worker's sources, so list and pins cannot
differ from the project's. Sizes are measured by `python scripts/measure_worker.py`.
"""

from __future__ import annotations

import json
import platform
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

from .errors import ChonaError

TORCH_INDEX = {"cpu": "https://download.pytorch.org/whl/cpu", "cuda": "https://download.pytorch.org/whl/cu130"}
"""Where pytorch.org tells to take torch's builds from; the pinned torch is built for CUDA 13.0."""
SIZES = Path(__file__).with_name("worker_sizes.json")


@dataclass(frozen=True)
class Package:
    """A package that chona_model imports: the oldest version that will do, and the one that is installed."""

    name: str
    minimum: str
    pinned: str

    @property
    def requirement(self) -> str:
        """For pip."""
        return f"{self.name}=={self.pinned}"


@dataclass(frozen=True)
class Size:
    """A measured environment: packages in all, bytes to download, bytes on the disk, bytes of each wheel by name."""

    packages: int
    download: int
    installed: int
    wheels: dict[str, int]


def packages(sources: Path) -> tuple[Package, ...]:
    """The packages that chona_model names.

    Raises:
        ChonaError: the lists are not beside the sources, or one has no pin.
    """
    try:
        project = tomllib.loads((sources / "pyproject.toml").read_text("utf-8"))["project"]
        pins = dict(re.findall(r"^([\w.-]+)==(\S+)$", constraints(sources).read_text("utf-8"), re.MULTILINE))
    except (OSError, KeyError, tomllib.TOMLDecodeError) as error:
        raise ChonaError(
            f"the list of the worker's packages cannot be read ({error}); install the extension again"
        ) from error
    found = []
    for text in project["dependencies"]:
        name, _, minimum = text.partition(">=")
        if name not in pins:
            raise ChonaError(f"{constraints(sources)} has no version of {name}; install the extension again")
        found.append(Package(name, minimum, pins[name]))
    return tuple(found)


def constraints(sources: Path) -> Path:
    """The file with the version of everything, for pip."""
    return sources / "constraints.txt"


def measured_size(device: str) -> Size | None:
    """How big an environment is on this system; None where nobody has measured one like it."""
    system = f"{platform.system()} {platform.machine()}"
    entry = json.loads(SIZES.read_text("utf-8"))["systems"].get(system, {}).get(device)
    if entry is None:
        return None
    return Size(len(entry["wheels"]), sum(entry["wheels"].values()), entry["installed"], entry["wheels"])


def older(version: str, minimum: str) -> bool:
    """Whether a version comes before another; what follows the numbers (`+cpu`, `rc1`) is not looked at."""

    def numbers(text: str) -> tuple[int, ...]:
        found = re.match(r"\d+(?:\.\d+)*", text)
        return tuple(int(part) for part in found[0].split(".")) if found else ()

    return numbers(version) < numbers(minimum)

"""The environment that the add-on has made for its worker: where it is, whether it is whole, and taking it away.

It lies in the extension's user folder, which an update of the add-on leaves alone and an uninstall removes.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import bpy

from .errors import ChonaError
from .worker_setup_process import PARTIAL, environment_python, folder_bytes

ENVIRONMENT, OLD = "worker", "worker.old"
READY = "chona-worker.json"
"""Inside the environment: written last, so what has it is whole."""


@dataclass(frozen=True)
class Ready:
    """What is written into a whole environment.

    Attributes:
        device: what torch was installed for, `cpu` or `cuda`.
        torch: its version.
        python: the Python that the environment was made of; without it the environment is dead.
        version: of the add-on that made it.
        bytes: size on the disk.
    """

    device: str
    torch: str
    python: str
    version: str
    bytes: int


def folder(create: bool = False) -> Path:
    """The add-on's own folder among the user's files.

    Raises:
        ChonaError: it cannot be made.
    """
    try:
        if __package__.startswith("bl_ext."):
            return Path(bpy.utils.extension_path_user(__package__, create=create))
        return Path(
            bpy.utils.user_resource("DATAFILES", path="chona", create=create)
        )  # a plain module, for development
    except OSError as error:
        raise ChonaError(
            f"the add-on's folder cannot be made ({error}); allow writing there, or set BLENDER_USER_RESOURCES"
        ) from error


def ready(environment: Path) -> Ready | None:
    """What is known of an environment; None where there is none, or half of one."""
    try:
        content = json.loads((environment / READY).read_text("utf-8"))
        kinds = {each.name: int if each.name == "bytes" else str for each in fields(Ready)}
        if not all(isinstance(content[name], kind) for name, kind in kinds.items()):
            return None
        return Ready(**{name: content[name] for name in kinds})
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None


def python() -> Path | None:
    """The Python of the add-on's own environment, None where none is set up.

    Raises:
        ChonaError: it is set up, and the Python that it was made of is gone.
    """
    environment = folder() / ENVIRONMENT
    found = ready(environment)
    if found is None:
        return None
    interpreter = environment_python(environment)
    if not interpreter.is_file():
        raise ChonaError(
            f"the worker's environment was made of {found.python}, which is gone; press Set Up Worker to make it again"
        )
    return interpreter


def adopt(environment: Path, facts: Ready) -> Path:
    """Put a checked environment in the place of the one before; returns its Python.

    Raises:
        ChonaError: something holds the old one, as Windows does with files in use.
    """
    home = folder()
    current, old = home / ENVIRONMENT, home / OLD
    partial = environment / f"{READY}.partial"
    partial.write_text(json.dumps(asdict(facts), indent=1), "utf-8")
    partial.replace(environment / READY)
    shutil.rmtree(old, ignore_errors=True)
    try:
        if current.exists():
            current.rename(old)
        environment.rename(current)
    except OSError as error:
        raise ChonaError(
            f"the new environment cannot take its place ({error}); end what uses the old one and set up again"
        ) from error
    shutil.rmtree(old, ignore_errors=True)
    shutil.rmtree(home / PARTIAL, ignore_errors=True)
    return environment_python(current)


def occupied() -> int:
    """Bytes of everything that set-ups have left: environment, downloads, half-made ones."""
    home = folder()
    return sum(folder_bytes(home / name) for name in (ENVIRONMENT, OLD, PARTIAL))


def remove() -> int:
    """Delete all that; the bytes that became free. What cannot be deleted at least no longer counts as set up.

    Raises:
        ChonaError: something holds it.
    """
    home, before = folder(), occupied()
    (home / ENVIRONMENT / READY).unlink(missing_ok=True)
    for name in (PARTIAL, OLD, ENVIRONMENT):
        try:
            if (home / name).exists():
                shutil.rmtree(home / name)
        except OSError as error:
            raise ChonaError(
                f"{error.filename or home / name} cannot be deleted ({error.strerror}); delete it yourself"
            ) from error
    return before - occupied()


def free_bytes(place: Path) -> int:
    """Free space where a folder is or will be."""
    while not place.exists():
        place = place.parent
    return shutil.disk_usage(place).free


def writable(place: Path) -> bool:
    """Whether files can be made in a folder, or in what of its path exists."""
    while not place.exists():
        place = place.parent
    return os.access(place, os.W_OK)

"""What the data folder holds: said by the worker when the folder is chosen, and checked with pictures on request.

Answers are kept while Blender runs, by folder and format; panels only read them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

from . import actions, messages, pictures, preferences
from .areas import redraw_areas
from .errors import ChonaError
from .events import need
from .jobs import DONE, FAILED, Job
from .worker import chona_command, find_python

PICTURE = "chona.data"
SHOWN_SIDE = 640
"""Pixels at most of a sheet's sides in the panel."""
LOOK_SECONDS = 0.3


@dataclass(frozen=True)
class Checked:
    """What was measured in a sequence: shares of 0…1 or None, and the picture of the checked views."""

    name: str
    views: int
    checked: int
    joints_inside: float | None
    objects_inside: float | None
    sheet: Path | None


@dataclass(frozen=True)
class Found:
    """What the worker understood of a data folder; `problem` says why it did not, `sound` whether it looks right."""

    headline: str = ""
    sequences: tuple[Checked, ...] = ()
    warnings: tuple[str, ...] = ()
    problem: str = ""
    sound: bool = True

    @property
    def checked(self) -> bool:
        """Whether images were opened."""
        return any(each.checked for each in self.sequences)


Key = tuple[str, str]


class _Known:
    """Answers, the look that is under way, where sheets are, and which one is shown."""

    found: dict[Key, Found] = {}
    look: tuple[Key, Job] | None = None
    places: dict[Key, TemporaryDirectory[str]] = {}
    shown: tuple[Key, int] | None = None


def key_of(scene: bpy.types.Scene) -> Key:
    """What an answer is kept by: the folder as the user wrote it made absolute, and the chosen format."""
    settings = scene.chona
    return (str(actions.absolute(settings.data_folder)), settings.data_format) if settings.data_folder else ("", "")


def found(scene: bpy.types.Scene) -> Found | None:
    """What is known of the scene's data folder; None while nobody has looked."""
    return _Known.found.get(key_of(scene))


def looking(scene: bpy.types.Scene) -> bool:
    """Whether the worker is looking into the scene's data folder."""
    return _Known.look is not None and _Known.look[0] == key_of(scene)


def look(scene: bpy.types.Scene) -> None:
    """Have the worker say what the data folder holds; the answer comes later. Without a window nobody would see it."""
    if bpy.app.background or not scene.chona.data_folder or found(scene) is not None or looking(scene):
        return
    _forget_look()
    key = key_of(scene)
    if not Path(key[0]).is_dir():
        _Known.found[key] = Found(problem=f"There is no folder {key[0]}")
        return
    try:
        # Not asked whether it has all that a worker needs: that takes a process of its own, and a look needs little.
        python, _ = find_python(preferences.worker_python())
        _Known.look = key, Job("Look at data", _command(python, key, "--brief"))
    except ChonaError as error:
        _Known.found[key] = Found(problem=messages.sentence(error))
        return
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=LOOK_SECONDS, persistent=True)


def _tick() -> float | None:
    if _Known.look is None:
        return None
    key, job = _Known.look
    if not job.poll():
        return LOOK_SECONDS
    _Known.look = None
    _Known.found.setdefault(key, answer_of(job))
    redraw_areas("VIEW_3D")
    return None


def _command(python: Path, key: Key, *more: str) -> list[str]:
    return chona_command(python, ["check-data", key[0], "--format", key[1], *more])


class CheckDataJob(Job):
    """A check with pictures. Data that look wrong end the worker with a code of its own; that is an answer too."""

    def __init__(self, key: Key, folder: Path | None) -> None:
        self.key = key
        self.place = TemporaryDirectory(prefix="chona_data_")
        out = str(folder or self.place.name)
        super().__init__(f"Check {Path(key[0]).name}", _command(actions.worker_python(), key, "--out", out))

    def poll(self) -> bool:
        """As every job's; an answer is an answer."""
        ended = super().poll()
        if ended and self.status == FAILED and self.result:
            self.status, self.error = DONE, ""
        return ended


def start_check(scene: bpy.types.Scene, folder: str = "") -> CheckDataJob:
    """Have the worker draw what it understands over the images of the data folder.

    Args:
        folder: where the pictures go and stay; without one they go with Blender.

    Raises:
        ChonaError: no data folder, or no worker.
    """
    actions.data_folder(scene, "Train")
    place = actions.writable_folder(folder, "folder for the pictures") if folder else None
    return CheckDataJob(key_of(scene), place)


def keep(job: CheckDataJob) -> Found:
    """Remember what a finished check has found, and show its first picture."""
    kept = answer_of(job)
    _Known.found[job.key], _Known.places[job.key] = kept, job.place
    _Known.shown = None
    show_sheet(job.key, 0)
    return kept


def answer_of(job: Job) -> Found:
    """What an ended job has said."""
    if not job.result:
        return Found(problem=messages.sentence(ChonaError(job.error or "the worker said nothing")))
    try:
        need(job.result, "headline", "sequences", "warnings", "sound")
    except ChonaError as error:
        return Found(problem=messages.sentence(error))
    sequences = tuple(
        Checked(
            each["name"], each["views"], each["checked"], each["joints_inside"], each["objects_inside"],
            Path(each["sheet"]) if each["sheet"] else None,
        )
        for each in job.result["sequences"]
    )  # fmt: skip
    return Found(job.result["headline"], sequences, tuple(job.result["warnings"]), sound=job.result["sound"])


def sheets(key: Key) -> Sequence[Checked]:
    """The sequences of a checked folder that have a picture."""
    known = _Known.found.get(key)
    return [] if known is None else [each for each in known.sequences if each.sheet is not None]


def shown_sheet(scene: bpy.types.Scene) -> tuple[int, Checked] | None:
    """Number and sequence of the picture that the panel shows; None where it shows none."""
    key = key_of(scene)
    if _Known.shown is None or _Known.shown[0] != key:
        return None
    drawn = sheets(key)
    return (_Known.shown[1], drawn[_Known.shown[1]]) if _Known.shown[1] < len(drawn) else None


def show_sheet(key: Key, index: int) -> None:
    """Put a sequence's picture into the panel; beyond the last comes the first."""
    drawn = sheets(key)
    if not drawn:
        pictures.forget(PICTURE)
        _Known.shown = None
        return
    index %= len(drawn)
    path = drawn[index].sheet
    try:
        sheet = pictures.read(path) if path is not None else np.zeros((1, 1, 3))
    except RuntimeError as error:
        raise ChonaError(f"the picture {path} cannot be read any more; press Check Data again") from error
    pictures.show(PICTURE, pictures.shrunk(sheet, SHOWN_SIDE))
    _Known.shown = key, index


def _forget_look() -> None:
    if _Known.look is not None:
        _Known.look[1].close()
        _Known.look = None


def forget() -> None:
    """Drop everything, sheets on the disk too: the add-on is switched off."""
    _forget_look()
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    for place in _Known.places.values():
        place.cleanup()
    _Known.found.clear()
    _Known.places.clear()
    _Known.shown = None

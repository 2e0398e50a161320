"""Jobs that went on while Blender was closed: found again when a file is opened, shown, and their ends told.

A thread looks into the folders that the file names; Blender's main thread then shows what runs, one job after the
other, and says how the others have ended.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import bpy

from . import frames_there, job_record, jobs, looking, messages, train_rows
from .areas import redraw_areas
from .detached_worker import DetachedWorker
from .errors import ChonaError
from .events import need
from .job_operator import JobOperator
from .job_record import JobRecord, bake_record, killed_words, left_words, train_record
from .output import Output, absolute, output_now
from .shot_job import BakeJob
from .train_job import TrainJob
from .train_queue import follow, has_checkpoint

LOOK_SECONDS, WAIT_SECONDS = 0.1, 0.5


@dataclass(frozen=True)
class Place:
    """Where a job may have been left.

    Attributes:
        record: its file; title: as panels show it.
        scene: ``session_uid`` of the scene that bakes there, 0 for a training.
        key: of the row of a training, empty without.
    """

    record: Path
    title: str
    scene: int = 0
    output: Output | None = None
    key: str = ""

    def job(self) -> jobs.Job:
        """A job that follows what runs there."""
        worker = DetachedWorker(self.record)
        if self.output is not None:
            return BakeJob(self.title, worker)
        row = train_rows.row_of(self.key)
        if row is not None:
            row.state = train_rows.RUNNING
            train_rows.select(self.key)
        return TrainJob(self.title, worker, self.record.parent, self.key, follow)


@dataclass(frozen=True)
class Found:
    """A job that was left: what it says, what it has printed, and whether it runs still."""

    place: Place
    record: JobRecord
    lines: tuple[str, ...]
    runs: bool


def bake_place(scene: bpy.types.Scene) -> Place | None:
    """Where a bake of the scene would be; None where its output is not set well."""
    output = output_now(scene)
    if output is None:
        return None
    return Place(bake_record(output.folder, output.name), f"Bake {output.name}", scene.session_uid, output)


def train_place(run: Path, key: str = "") -> Place:
    """Where a training into a folder would be."""
    return Place(train_record(run), f"Train {run.name}", key=key)


def places() -> list[Place]:
    """All places that the open file names, each once."""
    found: dict[Path, Place] = {}
    for place in _all_places():
        found.setdefault(place.record, place)
    return list(found.values())


def _all_places() -> Iterator[Place]:
    for scene in bpy.data.scenes:
        place = bake_place(scene)
        if place is not None:
            yield place
    for row in train_rows.rows():
        yield train_place(Path(row.run_folder), row.key)
    for scene in bpy.data.scenes:
        if scene.chona.run_folder.strip():
            yield train_place(absolute(scene.chona.run_folder))


def look_into(place: Place) -> Found | None:
    """What was left at a place; None where there is nothing, or something of another computer."""
    runs = job_record.is_running(place.record)
    record = job_record.read_record(place.record)
    if record is None or not record.is_here:
        return None
    runs = record.end is None if runs is None else runs  # followed, it is seen whether it does
    return Found(place, record, () if runs else tuple(job_record.last_lines(place.record)), runs)


def running_at(place: Place | None) -> jobs.Job | None:
    """A job that follows what runs at a place; None where nothing does.  What has ended there is not told any more."""
    found = look_into(place) if place is not None else None
    if found is not None and not found.runs:
        job_record.clear(found.place.record)
    return found.place.job() if found is not None and found.runs else None


def tell(found: Found) -> None:
    """Say how a job has ended, once, and take away what it has left."""
    ended, words = end_of(found)
    text = messages.sentence(ChonaError(f"{found.place.title} {words}"))
    if ended == jobs.FAILED:
        messages.remember_error(text)
    else:
        messages.add_news(text)
    row = train_rows.row_of(found.place.key)
    if row is not None:
        paused = ended == jobs.CANCELLED and has_checkpoint(row)
        row.state, row.words = train_rows.PAUSED if paused else ended, text
        row.resume = row.resume or has_checkpoint(row)
    frames_there.look_again()
    job_record.clear(found.place.record)


def end_of(found: Found) -> tuple[str, str]:
    """How a job has ended, as a job's status, and in words that go on from its title."""
    record, end = found.record, found.record.end
    if end is None:
        return jobs.FAILED, f"ended without Blender: {killed_words(record, found.lines)}; {left_words(record)}"
    when = f"at {record.written}"
    if end["event"] == "error":
        return jobs.FAILED, f"failed {when}: {end.get('message') or 'it did not say why'}"
    words = ""
    if found.place.output is None:
        words = f"; its model is {end['model']}" if "model" in end else ""
    elif {"written", "skipped"} <= end.keys():
        words = f": {baked_words(end)} in {found.place.record.parent}"
    if end["event"] == "result":
        return jobs.DONE, f"has finished {when}{words}"
    return jobs.CANCELLED, f"was cancelled {when}{words}"


def baked_words(result: dict[str, Any]) -> str:
    """`12 frames written, 38 left as they were`, of a bake's result.

    Raises:
        ChonaError: the result does not say it.
    """
    need(result, "written", "skipped")
    written, skipped = result["written"], result["skipped"]
    words = f"{written} frame{'s' * (written != 1)} written"
    return f"{words}, {skipped} left as they were" if skipped else words


class _State:
    """The look whose answer counts, and the jobs that run and are not shown yet."""

    look: object = None
    waiting: list[Place] = []


def look_now() -> None:
    """Look into all places, tell what has ended, and have what runs wait to be shown."""
    _take(_look_into_all(places()))


def _look_into_all(at: list[Place]) -> list[Found]:
    return [found for found in map(look_into, at) if found is not None]


def _take(all_found: list[Found]) -> None:
    _State.waiting = [found.place for found in all_found if found.runs]
    for found in all_found:
        if not found.runs:
            tell(found)


def is_waiting() -> bool:
    """Whether a job runs that is not shown yet."""
    return bool(_State.waiting)


def take_next() -> tuple[Place, jobs.Job]:
    """The job that is to be shown next, and where it is.

    Raises:
        ChonaError: there is none.
    """
    if _State.waiting:
        place = _State.waiting.pop(0)
        return place, place.job()
    raise ChonaError("no job of this file goes on without Blender")


def _show_next() -> float | None:
    windows = bpy.context.window_manager.windows
    if _State.waiting and windows and jobs.running() is None:
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.chona.pick_up("INVOKE_DEFAULT")
    return WAIT_SECONDS if _State.waiting else None


def _begin() -> None:
    """Start a look; a file is open now, which it is not yet while add-ons are switched on."""
    look = _State.look = object()
    looking.look(partial(_look_into_all, places()), partial(_tell_and_show, look))


def _tell_and_show(look: object, all_found: list[Found]) -> None:
    if look is not _State.look:  # it was into the folders of another file
        return
    _take(all_found)
    redraw_areas("VIEW_3D")
    bpy.app.timers.register(_show_next)


@bpy.app.handlers.persistent
def look_soon(*_: object) -> None:
    """Look into all places, beside everything else.  Without a window nobody would see it: there an operator looks."""
    forget()
    if not bpy.app.background:
        bpy.app.timers.register(_begin, first_interval=LOOK_SECONDS)


class DetachableOperator(JobOperator):
    """Mixin for operators over a job that may go on without them."""

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator: where that is not for another file, but its window was closed, look again."""
        super().cancel(context)
        look_soon()


def forget() -> None:
    """Drop what was found."""
    for timer in (_begin, _show_next):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    _State.waiting, _State.look = [], None


def register() -> None:
    """Look into the file's folders now, and whenever one is opened."""
    bpy.app.handlers.load_post.append(look_soon)
    look_soon()


def unregister() -> None:
    """Look no more."""
    bpy.app.handlers.load_post.remove(look_soon)
    forget()

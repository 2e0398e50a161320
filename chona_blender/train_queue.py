"""Trainings one after the other: from the scene's settings to a row, from a row to a job, and what comes of it."""

from __future__ import annotations

import secrets
from pathlib import Path

import bpy

from . import actions, jobs, messages, train_rows
from .detached_worker import DetachedWorker
from .errors import ChonaError
from .job_record import train_record
from .train_job import CHECKPOINT, TrainJob
from .train_properties import SCANS
from .train_rows import CANCELLED, FAILED, PAUSED, RUNNING, WAITING, CHONA_PG_training
from .train_view import MODEL
from .worker import chona_command, detached_command

WAKE_SECONDS = 0.5


class _Queue:
    """What is not in the rows: whether waiting ones may start."""

    held = False


def add(scene: bpy.types.Scene) -> CHONA_PG_training:
    """Append the training that the scene's settings ask for.

    Raises:
        ChonaError: a folder is missing or cannot be written, or a training into the same folder is not over yet.
    """
    settings = scene.chona
    data = actions.data_folder(scene, "Train")
    base, identities = _added_to(settings)
    run = actions.writable_folder(settings.run_folder, "result folder")
    list_ = train_rows.trainings()
    for index, row in reversed(list(enumerate(list_.rows))):
        if Path(row.run_folder) != run:
            continue
        if row.state in {WAITING, RUNNING, PAUSED}:
            raise ChonaError(
                f"a training into {run} is {_state_words(row.state)} already; choose another result folder, or remove "
                "that one from the list"
            )
        list_.rows.remove(index)
    row = list_.rows.add()
    row.key, row.name, row.state = secrets.token_hex(8), run.name, WAITING
    row.data_folder, row.run_folder, row.data_format = str(data), str(run), settings.data_format
    row.sequences, row.method = ",".join(actions.listed(settings.sequences)), settings.train_preset
    row.minutes, row.steps, row.resume = settings.minutes, settings.train_steps, settings.resume
    row.preview, row.object_size = settings.preview_every, settings.object_size
    row.base, row.identities = str(base or ""), ",".join(identities)
    row.detach = settings.detach
    _Queue.held = False
    if not any(each.state == RUNNING for each in list_.rows):  # its curves stay in view
        train_rows.select(row.key)
    return row


def _added_to(settings: bpy.types.PropertyGroup) -> tuple[Path | None, list[str]]:
    """The model that is added to and what is added; (None, []) for a training of its own."""
    if not settings.base_model:
        return None, []
    base, identities = actions.absolute(settings.base_model), actions.listed(settings.identities)
    if not base.is_file():
        raise ChonaError(f"there is no model {base} to add to; choose one under Add To, or empty it to train a new one")
    if not identities:
        raise ChonaError(
            f"nothing is named that {base.name} is to get; write the names under Who, as Check Data has them"
        )
    return base, identities


def _state_words(state: str) -> str:
    return next(label.lower() for name, label, *_ in train_rows.STATES if name == state)


def next_waiting() -> CHONA_PG_training | None:
    """The training that is to start now; None while the queue is held, or something runs."""
    if _Queue.held or jobs.running() is not None:
        return None
    return next((row for row in train_rows.rows() if row.state == WAITING), None)


def is_waiting() -> bool:
    """Whether a training will start by itself when what runs has ended."""
    return not _Queue.held and any(row.state == WAITING for row in train_rows.rows())


def start(row: CHONA_PG_training) -> TrainJob:
    """Start a row's training; where that fails the row says why.

    Raises:
        ChonaError: no worker, or folders that are not there any more.
    """
    key = row.key
    try:
        run, arguments = Path(row.run_folder), _arguments(row)
        python = actions.worker_python()
        if row.detach:
            record = train_record(run)
            worker = DetachedWorker.start(detached_command(python, arguments, record), record)
            job = TrainJob(f"Train {row.name}", worker, run, key, follow)
        else:
            job = TrainJob(f"Train {row.name}", chona_command(python, arguments), run, key, follow)
    except ChonaError as error:
        ended = train_rows.row_of(key)
        if ended is not None:
            ended.state, ended.words = FAILED, messages.sentence(error)
        raise
    row.state, row.words = RUNNING, ""
    train_rows.select(key)
    return job


def _arguments(row: CHONA_PG_training) -> list[str]:
    if not Path(row.data_folder).is_dir():
        raise ChonaError(f"there is no data folder {row.data_folder} any more; remove this training, and add it again")
    actions.writable_folder(row.run_folder, "result folder")
    sources = ["--data", row.data_folder, "--format", row.data_format]
    if row.data_format in SCANS:
        sources += ["--object-size", f"{row.object_size:g}"]
    arguments = ["train", "--preset", row.method]
    if row.base:
        arguments = ["add", "--model", row.base, "--identity", row.identities]
    arguments += [*sources, "--out", row.run_folder, *actions.device()]
    arguments += ["--steps", str(row.steps)] if row.steps else ["--minutes", f"{row.minutes:g}"]
    if row.sequences:
        arguments += ["--sequences", row.sequences]
    if row.preview > 0.0:
        arguments += ["--preview-every", f"{row.preview:g}"]
    if row.resume:
        arguments.append("--resume")
    return arguments


def follow(job: TrainJob) -> None:
    """Write into the row how far its training is."""
    row = train_rows.row_of(job.key)
    if row is not None and row.state == RUNNING:
        row.share = job.share
        row.words = job.text if job.status == jobs.RUNNING else job.error
        if job.status != jobs.RUNNING:
            row.state = job.status
            row.resume = row.resume or has_checkpoint(row)
            _Queue.held = _Queue.held or job.status == PAUSED


def has_checkpoint(row: CHONA_PG_training) -> bool:
    """Whether a training can go on from where it stopped."""
    return (Path(row.run_folder) / CHECKPOINT).is_file()


def model_of(row: CHONA_PG_training) -> Path:
    """Where a training leaves its model."""
    return Path(row.run_folder) / MODEL


def resume(row: CHONA_PG_training) -> None:
    """Have a stopped training go on before all that wait."""
    list_ = train_rows.trainings()
    here = next(index for index, each in enumerate(list_.rows) if each.key == row.key)
    row.resume, row.state, row.words = has_checkpoint(row), WAITING, ""
    first = next(index for index, each in enumerate(list_.rows) if each.state == WAITING)
    list_.rows.move(here, min(here, first))
    train_rows.select(list_.rows[min(here, first)].key)
    _Queue.held = False


def stop(row: CHONA_PG_training, job: jobs.Job | None, *, pause: bool) -> None:
    """Pause or cancel a training that runs, or cancel one that waits."""
    if isinstance(job, TrainJob) and job.key == row.key:
        if pause:
            job.pause()
        else:
            job.cancel()
    elif row.state in {WAITING, PAUSED}:
        row.state, row.words = CANCELLED, "cancelled before it was started" if not has_checkpoint(row) else ""


def move(row: CHONA_PG_training, by: int) -> None:
    """Move a row up (-1) or down (1) in the list, which is the order of those that wait."""
    list_ = train_rows.trainings()
    here = next(index for index, each in enumerate(list_.rows) if each.key == row.key)
    there = min(max(here + by, 0), len(list_.rows) - 1)
    list_.rows.move(here, there)
    train_rows.select(list_.rows[there].key)


def remove(row: CHONA_PG_training) -> None:
    """Take a row out of the list; files stay."""
    list_ = train_rows.trainings()
    here = next(index for index, each in enumerate(list_.rows) if each.key == row.key)
    list_.rows.remove(here)
    list_.active = max(0, min(list_.active, len(list_.rows) - 1))


def wake() -> None:
    """Start what waits as soon as nothing runs any more."""
    if not bpy.app.background and not bpy.app.timers.is_registered(_start_next):
        bpy.app.timers.register(_start_next, first_interval=WAKE_SECONDS)


def _start_next() -> float | None:
    if next_waiting() is not None and bpy.context.window_manager.windows:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.chona.run_trainings("INVOKE_DEFAULT")
        return None
    return WAKE_SECONDS if is_waiting() else None


def forget() -> None:
    """Drop what is not in the rows: the add-on is switched off."""
    _Queue.held = False
    if bpy.app.timers.is_registered(_start_next):
        bpy.app.timers.unregister(_start_next)

"""A training run: the loop around a trainer, with a time or step budget, a log, checkpoints and cancelling."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import msgspec
from torch import Tensor

from chona_model.actor import Actor
from chona_model.data.dataset import Dataset
from chona_model.formats.atomic import WriteError
from chona_model.formats.folder_lock import FolderLock, FolderLostError, lock_folder
from chona_model.launch import read_launch
from chona_model.methods import METHODS
from chona_model.model_store import save_actor
from chona_model.progress import Progress
from chona_model.train import together
from chona_model.train.checkpoint import NAME, Position, load_checkpoint, refused, save_checkpoint, saved_by
from chona_model.train.errors import NotSavedError, TrainingError
from chona_model.train.guard import Guard, GuardSettings
from chona_model.train.log import TrainingLog
from chona_model.train.pose_summary import poses_seen
from chona_model.train.preview import NAME as PREVIEW
from chona_model.train.preview import Preview
from chona_model.train.repeatable import repeatable

DEFAULT_STEPS = {"fast": 4000, "paper": 100_000}
CHECKPOINT_SECONDS = 60.0
LOG_EVERY = 20
MODEL = "model.safetensors"
WHAT = "training"
"""What is locked in a run's folder."""
STOP = "stop"
"""A file of this name in the run's folder ends the training after the step it is in, as SIGTERM does; it is removed.
Where a program cannot send signals, as on Windows, it stops a training so without losing a step."""


@dataclass(frozen=True)
class TrainRun:
    """What to train and for how long.

    Attributes:
        method: one of ``methods.METHODS``; preset: ``fast`` or ``paper``.
        minutes, steps: the budget, one of them; neither means the preset's usual number of steps.
        image_scale: size of the images used, 0…1.
        device, seed: as everywhere.
        resume: continue from the run's checkpoint.
        data_statement: what the model was trained on, in words; kept in the model file.
        preview_every: seconds between two pictures ``OUT/preview.png``; None draws none.  The model is the same.
    """

    method: str = "chona"
    preset: str = "fast"
    minutes: float | None = None
    steps: int | None = None
    image_scale: float = 1.0
    device: str = "cpu"
    seed: int = 0
    resume: bool = False
    data_statement: str = ""
    preview_every: float | None = None


class Trainer(Protocol):
    """What the loop drives."""

    @property
    def rates(self) -> str: ...
    def step(self, index: int, share: float) -> dict[str, float]: ...
    def tensors(self) -> dict[str, Tensor]: ...
    def state(self) -> dict[str, Tensor]: ...
    def restore(self, state: dict[str, Tensor], done: int) -> None: ...
    def actor(self) -> Actor: ...


def make_trainer(dataset: Dataset, run: TrainRun) -> tuple[Trainer, dict[str, Any]]:
    """The preset's trainer and its settings.

    Raises:
        ValueError: an unknown method or preset.
    """
    if run.method not in METHODS:
        raise ValueError(f"method '{run.method}' is unknown; expected one of {', '.join(METHODS)}")
    method = METHODS[run.method]
    if run.preset == "fast":
        from chona_model.train.fast_settings import FastSettings
        from chona_model.train.grid_trainer import GridTrainer

        settings = FastSettings()
        fast = GridTrainer(dataset, settings, run.seed, run.image_scale, method, device=run.device)
        return fast, asdict(settings)
    if run.preset == "paper":
        from chona_model.train.exact_trainer import ExactTrainer, PaperSettings

        paper = PaperSettings()
        trainer = ExactTrainer(dataset, paper, run.seed, run.device, run.image_scale, method)
        return trainer, asdict(paper)
    raise ValueError(f"training preset '{run.preset}' is unknown; expected fast or paper")


def train(dataset: Dataset, out: Path, run: TrainRun, progress: Progress) -> Path:
    """Trains and writes ``OUT/model.safetensors``, ``log.jsonl`` and checkpoints.

    The time budget counts optimisation, not reading data or compiling kernels.  When cancelled, checkpoint and model
    are written before returning.  A model that is ruined (``guard.py``) is never written, over nothing.  Of several
    processes (``together.py``) the first writes and reports; all return the same.

    Returns:
        the model file.

    Raises:
        DatasetError, TrainingError, CheckpointError, OSError.
    """
    model = out / MODEL
    with held_folder(out) as held:
        with repeatable(run.device):
            trainer, settings = make_trainer(dataset, run)
            identity = {"preset": run.preset, "method": run.method}
            actor, training = run_trainer(trainer, dataset, out, held, run, identity, progress)
        if together.leads():
            save_model(model, actor, run.method, {"preset": run.preset, **settings}, training)
    report_end(progress, model, training)
    return model


@contextmanager
def held_folder(out: Path) -> Iterator[FolderLock | None]:
    """The lock on a run's folder; of several processes that train together the first has it, the others None.

    What asked an earlier training to stop is removed at once: whatever asks from here on asks this one.

    Raises:
        FolderBusyError: another training writes into it.
    """
    if not together.leads():
        yield None
        return
    with lock_folder(out, WHAT) as held:
        if read_launch().attempt == 0:  # a later attempt goes on with what was asked of the first
            (out / STOP).unlink(missing_ok=True)
        yield held


def run_trainer(
    trainer: Trainer, dataset: Dataset, out: Path, held: FolderLock | None, run: TrainRun, identity: dict[str, Any],
    progress: Progress,
) -> tuple[Actor, dict[str, Any]]:  # fmt: skip
    """Trains until the budget is spent or the user wants an end, with log and checkpoints in ``out``.

    Args:
        held: the lock on that folder (see ``held_folder``).
        identity: what else than seed, image size and data a checkpoint must agree in to be continued.

    Returns:
        what was learned, and what a model file says of its training.

    Raises:
        TrainingError, CheckpointError, OSError.
    """
    preview = None
    if together.leads():
        if not run.resume:
            (out / PREVIEW).unlink(missing_ok=True)
        preview = None if run.preview_every is None else Preview(dataset, out, run.preview_every)
    identity = identity | {
        "seed": run.seed, "image_scale": run.image_scale, "persons": sorted(dataset.persons),
        "objects": sorted(dataset.objects), "views": len(dataset.views),
        "sequences": sorted({view.sequence for view in dataset.views}),
    }  # fmt: skip
    loop = _Loop(trainer, out, held, run, identity, preview)
    try:
        loop.run(progress)
    except TrainingError as error:
        raise type(error)(f"{error}; {loop.kept()}") from error
    except (WriteError, FolderLostError) as error:
        raise NotSavedError(f"{error}; {loop.kept()}") from error
    training = {"steps": loop.done, "seconds": round(loop.spent, 2),
                "poses": len({(v.sequence, v.frame) for v in dataset.views}), "views": len(dataset.views),
                "data": run.data_statement, "finished": not progress.cancelled_by_user,
                "poses_seen": poses_seen(dataset)}  # fmt: skip
    return trainer.actor(), training


def save_model(path: Path, actor: Actor, method: str, settings: dict[str, Any], training: dict[str, Any]) -> None:
    """Writes the model of a training whose last checkpoint is there.

    Raises:
        NotSavedError: the disk is full, or the folder cannot be written to.
    """
    try:
        save_actor(path, actor, method, settings, training)
    except WriteError as error:
        raise NotSavedError(f"{error}; {_model_of_checkpoint(training['steps'])}") from error


def _model_of_checkpoint(step: int) -> str:
    return f"the checkpoint of step {step} is kept, --resume --steps {step} makes a model of it"


def report_end(progress: Progress, model: Path, training: dict[str, Any]) -> None:
    """Tells the user where the model is."""
    if progress.cancelled_by_user:
        progress.cancelled(model=str(model), step=training["steps"])
    else:
        progress.result(model=str(model), steps=training["steps"], seconds=training["seconds"])


def _continued_by_launcher(out: Path) -> bool:
    """Whether torchrun has started this job anew, and there is something of its own to continue."""
    launch = read_launch()
    return launch.attempt > 0 and saved_by(out) == launch.job


class _Loop:
    """Steps until the budget is spent, with guard, log and checkpoints.

    Attributes:
        done, spent: steps and seconds of training so far; saved: step of the run's checkpoint, None without one.
    """

    def __init__(
        self, trainer: Trainer, out: Path, held: FolderLock | None, run: TrainRun, identity: dict[str, Any],
        preview: Preview | None,
    ) -> None:  # fmt: skip
        self.trainer, self.out, self.held, self.identity, self.preview = trainer, out, held, identity, preview
        self.budget = run.minutes * 60.0 if run.minutes is not None else None
        self.steps = run.steps or (DEFAULT_STEPS[run.preset] if self.budget is None else 1)
        self.saved: int | None = None
        position = Position(step=0, seconds=0.0)
        if together.leads() and (run.resume or _continued_by_launcher(out)):
            state, position = load_checkpoint(out, identity)
            self.saved = position.step
            Guard(GuardSettings(), trainer.rates, position.guard).look(self.saved, state)
            with refused(out / NAME):
                trainer.restore(state, self.saved)
        position = msgspec.convert(together.same_state(trainer, msgspec.to_builtins(position)), Position)
        self.done, self.spent = position.step, position.seconds
        self.guard = Guard(GuardSettings(), trainer.rates, position.guard)

    def run(self, progress: Progress) -> None:
        """Trains, and writes the last checkpoint."""
        unit = "s" if self.budget is not None else "step"
        progress.start("train", self.budget or self.steps, self._shown(), unit)
        report: dict[str, float] = {}
        with TrainingLog(self.out, self.done) if together.leads() else nullcontext() as log:
            began = time.perf_counter() - self.spent
            saved, warm, before = time.perf_counter(), False, self.spent
            continued = progress.cancel.continued
            while (share := self._agreed_share(progress)) < 1.0:
                report = self.trainer.step(self.done, share)
                self.done += 1
                if progress.cancel.continued != continued:  # it was stopped since the last step: that is no training
                    continued, began = progress.cancel.continued, time.perf_counter() - self.spent
                if not warm:
                    began, warm = time.perf_counter() - before, True  # the first step compiled the kernels
                self.spent = time.perf_counter() - began
                drawn = self._draw()
                if drawn:
                    began = time.perf_counter() - self.spent  # a picture is no training
                    report = report | drawn
                if log is not None and (self.done % LOG_EVERY == 0 or self.done == 1 or drawn):
                    log.write(self.done, self.spent, report)
                    self._tell(progress, report)
                self.guard.observe(self.done, report)
                if self.guard.look_due(self.done):
                    self.guard.look(self.done, self.trainer.tensors())
                due = time.perf_counter() - saved > CHECKPOINT_SECONDS
                if due and together.leads() and not self.guard.lost_what_it_had:
                    self._save()
                    saved = time.perf_counter()
        if report:
            self._tell(progress, report)
        self.guard.close(self.done)
        if together.leads():
            self._save()

    def _agreed_share(self, progress: Progress) -> float:
        """How much of the schedule is done, the same in all processes; 1 where the user wants an end, by a signal to
        one of them or by the file ``STOP``."""
        if together.leads() and (self.out / STOP).exists():
            (self.out / STOP).unlink(missing_ok=True)
            progress.cancel.request()
        stop, share, self.saved = together.agree(progress.cancelled_by_user, self.share, self.saved)
        if stop:
            progress.cancel.request()
        return 1.0 if stop else share

    def _draw(self) -> dict[str, float]:
        """Draws a preview where one is due; its PSNR for the log."""
        if self.preview is None or not self.preview.due():
            return {}
        return {"preview_psnr": round(self.preview.draw(self.trainer.actor()), 3)}

    @property
    def share(self) -> float:
        """How much of the schedule is done, 0…1."""
        return self.spent / self.budget if self.budget is not None else self.done / self.steps

    def kept(self) -> str:
        """What is on the disk now that training has failed, in words."""
        model = f"; {self.out / MODEL} is the one from before" if (self.out / MODEL).exists() else ""
        if self.saved is None:
            return f"no checkpoint was written, and no model{model}"
        return f"{_model_of_checkpoint(self.saved)}, --resume alone goes on, and no model was written{model}"

    def _save(self) -> None:
        """Raises TrainingError and leaves the checkpoint before as it is where a number is not finite."""
        state = self.trainer.state()
        self.guard.look(self.done, state)
        if self.held is not None:
            self.held.check()
        position = {"step": self.done, "seconds": self.spent, "guard": self.guard.position()}
        position |= {"job": read_launch().job} if read_launch().job else {}
        save_checkpoint(self.out, state, position, self.identity)
        self.saved = self.done

    def _shown(self) -> float:
        return round(min(self.spent, self.budget), 2) if self.budget is not None else self.done

    def _tell(self, progress: Progress, report: dict[str, float]) -> None:
        shown: dict[str, Any] = {name: report[name] for name in ("loss", "psnr", "preview_psnr") if name in report}
        progress.update(self._shown(), f"step {self.done}", **shown)

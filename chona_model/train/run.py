"""A training run: the loop around a trainer, with a time or step budget, a log, checkpoints and cancelling."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from torch import Tensor

from chona_model.actor import Actor
from chona_model.data.dataset import Dataset
from chona_model.formats.atomic import WriteError
from chona_model.formats.folder_lock import FolderLock, FolderLostError, lock_folder
from chona_model.methods import METHODS
from chona_model.model_store import save_actor
from chona_model.progress import Progress
from chona_model.train.checkpoint import load_checkpoint, save_checkpoint
from chona_model.train.errors import NotSavedError, TrainingError
from chona_model.train.guard import Guard, GuardSettings, GuardState
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
    are written before returning.  A model that is ruined (``guard.py``) is never written, over nothing.

    Returns:
        the model file.

    Raises:
        DatasetError, TrainingError, CheckpointError, OSError.
    """
    model = out / MODEL
    with lock_folder(out, WHAT) as held:
        with repeatable(run.device):
            trainer, settings = make_trainer(dataset, run)
            identity = {"preset": run.preset, "method": run.method}
            actor, training = run_trainer(trainer, dataset, held, run, identity, progress)
        save_model(model, actor, run.method, {"preset": run.preset, **settings}, training)
    report_end(progress, model, training)
    return model


def run_trainer(
    trainer: Trainer, dataset: Dataset, held: FolderLock, run: TrainRun, identity: dict[str, Any], progress: Progress
) -> tuple[Actor, dict[str, Any]]:
    """Trains until the budget is spent or the user wants an end, with log and checkpoints in a folder.

    Args:
        held: the lock on that folder.
        identity: what else than seed, image size and data a checkpoint must agree in to be continued.

    Returns:
        what was learned, and what a model file says of its training.

    Raises:
        TrainingError, CheckpointError, OSError.
    """
    out = held.path.parent
    (out / STOP).unlink(missing_ok=True)
    identity = identity | {
        "seed": run.seed, "image_scale": run.image_scale, "persons": sorted(dataset.persons),
        "objects": sorted(dataset.objects), "views": len(dataset.views),
        "sequences": sorted({view.sequence for view in dataset.views}),
    }  # fmt: skip
    if not run.resume:
        (out / PREVIEW).unlink(missing_ok=True)
    preview = None if run.preview_every is None else Preview(dataset, out, run.preview_every)
    loop = _Loop(trainer, held, run, identity, preview)
    try:
        loop.run(progress)
    except TrainingError as error:
        raise TrainingError(f"{error}; {loop.kept()}") from error
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


class _Loop:
    """Steps until the budget is spent, with guard, log and checkpoints.

    Attributes:
        done, spent: steps and seconds of training so far; saved: step of the run's checkpoint, None without one.
    """

    def __init__(
        self, trainer: Trainer, held: FolderLock, run: TrainRun, identity: dict[str, Any], preview: Preview | None
    ) -> None:
        out = held.path.parent
        self.trainer, self.held, self.out, self.identity, self.resumes = trainer, held, out, identity, run.resume
        self.preview = preview
        self.budget = run.minutes * 60.0 if run.minutes is not None else None
        self.steps = run.steps or (DEFAULT_STEPS[run.preset] if self.budget is None else 1)
        self.done, self.spent = 0, 0.0
        self.saved: int | None = None
        self.guard = Guard(GuardSettings(), trainer.rates)
        if run.resume:
            state, position = load_checkpoint(out, identity)
            self.done, self.spent = int(position["step"]), float(position["seconds"])
            self.saved = self.done
            self.guard = Guard(GuardSettings(), trainer.rates, GuardState(**position.get("guard", {})))
            self.guard.look(self.done, state)
            trainer.restore(state, self.done)

    def run(self, progress: Progress) -> None:
        """Trains, and writes the last checkpoint."""
        unit = "s" if self.budget is not None else "step"
        progress.start("train", self.budget or self.steps, self._shown(), unit)
        report: dict[str, float] = {}
        with TrainingLog(self.out, self.done if self.resumes else 0) as log:
            began = time.perf_counter() - self.spent
            saved, warm, before = time.perf_counter(), False, self.spent
            continued = progress.cancel.continued
            while not self._stopped(progress) and self.share < 1.0:
                report = self.trainer.step(self.done, self.share)
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
                if self.done % LOG_EVERY == 0 or self.done == 1 or drawn:
                    log.write(self.done, self.spent, report)
                    self._tell(progress, report)
                self.guard.observe(self.done, report)
                if self.guard.look_due(self.done):
                    self.guard.look(self.done, self.trainer.tensors())
                due = time.perf_counter() - saved > CHECKPOINT_SECONDS
                if due and not self.guard.lost_what_it_had:
                    self._save()
                    saved = time.perf_counter()
        if report:
            self._tell(progress, report)
        self.guard.close(self.done)
        self._save()

    def _stopped(self, progress: Progress) -> bool:
        """Whether the user wants an end: by a signal, or by the file ``STOP``."""
        if (self.out / STOP).exists():
            (self.out / STOP).unlink(missing_ok=True)
            progress.cancel.request()
        return progress.cancelled_by_user

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
        self.held.check()
        position = {"step": self.done, "seconds": self.spent, "guard": self.guard.position()}
        save_checkpoint(self.out, state, position, self.identity)
        self.saved = self.done

    def _shown(self) -> float:
        return round(min(self.spent, self.budget), 2) if self.budget is not None else self.done

    def _tell(self, progress: Progress, report: dict[str, float]) -> None:
        shown = {name: report[name] for name in ("loss", "psnr", "preview_psnr") if name in report}
        progress.update(self._shown(), f"step {self.done}", **shown)

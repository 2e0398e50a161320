"""A training run: the loop around a trainer, with a time or step budget, a log, checkpoints and cancelling."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from torch import Tensor

from chona_model.actor import Actor
from chona_model.data.dataset import Dataset
from chona_model.model_store import save_actor
from chona_model.progress import Progress
from chona_model.train.checkpoint import load_checkpoint, save_checkpoint

METHODS = ("chona", "no-cil")
DEFAULT_STEPS = {"fast": 4000, "paper": 100_000}
CHECKPOINT_SECONDS = 60.0
LOG_EVERY = 20


@dataclass(frozen=True)
class TrainRun:
    """What to train and for how long.

    Attributes:
        method: ``chona`` or ``no-cil``; preset: ``fast`` or ``paper``.
        minutes, steps: the budget, one of them; neither means the preset's usual number of steps.
        image_scale: size of the images used, 0…1.
        device, seed: as everywhere.
        resume: continue from the run's checkpoint.
        data_statement: what the model was trained on, in words; kept in the model file.
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


class Trainer(Protocol):
    """What the loop drives."""

    def step(self, index: int, share: float) -> dict[str, float]: ...
    def state(self) -> dict[str, Tensor]: ...
    def restore(self, state: dict[str, Tensor], done: int) -> None: ...
    def actor(self) -> Actor: ...


def make_trainer(dataset: Dataset, run: TrainRun) -> tuple[Trainer, dict[str, Any]]:
    """The preset's trainer and its settings.

    Raises:
        ValueError: an unknown method or preset.
    """
    if run.method not in METHODS:
        raise ValueError(f"method '{run.method}' is not in this version; it trains: {', '.join(METHODS)}")
    if run.preset == "fast":
        from chona_model.train.fast_settings import FastSettings
        from chona_model.train.grid_trainer import GridTrainer

        settings = FastSettings()
        fast = GridTrainer(dataset, settings, run.seed, run.image_scale, run.method, device=run.device)
        return fast, asdict(settings)
    if run.preset == "paper":
        from chona_model.train.exact_trainer import ExactTrainer, PaperSettings

        paper = PaperSettings()
        trainer = ExactTrainer(dataset, paper, run.seed, run.device, run.image_scale, run.method)
        return trainer, asdict(paper)
    raise ValueError(f"training preset '{run.preset}' is unknown; expected fast or paper")


def train(dataset: Dataset, out: Path, run: TrainRun, progress: Progress) -> Path:
    """Trains and writes ``OUT/model.safetensors``, ``log.jsonl`` and checkpoints.

    The time budget counts optimisation, not reading data or compiling kernels.  When cancelled, checkpoint and model
    are written before returning.

    Returns:
        the model file.

    Raises:
        DatasetError, TrainingError, CheckpointError, OSError.
    """
    out.mkdir(parents=True, exist_ok=True)
    budget = run.minutes * 60.0 if run.minutes is not None else None
    steps = run.steps or (DEFAULT_STEPS[run.preset] if budget is None else None)
    trainer, settings = make_trainer(dataset, run)
    identity = {
        "preset": run.preset, "method": run.method, "seed": run.seed, "image_scale": run.image_scale,
        "persons": sorted(dataset.persons), "objects": sorted(dataset.objects), "views": len(dataset.views),
    }  # fmt: skip
    done, spent = 0, 0.0
    if run.resume:
        state, position = load_checkpoint(out, identity)
        done, spent = int(position["step"]), float(position["seconds"])
        trainer.restore(state, done)
    progress.start(
        "train", budget or steps or 1, spent if budget is not None else done, "s" if budget is not None else "step"
    )
    log = (out / "log.jsonl").open("a" if run.resume else "w", encoding="utf-8")
    with log:
        began = time.perf_counter() - spent
        saved = time.perf_counter()
        warm, report = done > 0, {}
        while not progress.cancelled_by_user:
            share = spent / budget if budget is not None else done / max(steps or 1, 1)
            if share >= 1.0:
                break
            report = trainer.step(done, share)
            done += 1
            if not warm:
                began, warm = time.perf_counter(), True  # the first step compiled the kernels
            spent = time.perf_counter() - began
            if done % LOG_EVERY == 0 or done == 1:
                log.write(json.dumps({"step": done, "seconds": round(spent, 3), **report}) + "\n")
                shown = round(min(spent, budget), 2) if budget is not None else done
                progress.update(shown, f"step {done}", **report)
            if time.perf_counter() - saved > CHECKPOINT_SECONDS:
                log.flush()
                save_checkpoint(out, trainer.state(), {"step": done, "seconds": spent}, identity)
                saved = time.perf_counter()
        if report:
            progress.update(round(min(spent, budget), 2) if budget is not None else done, f"step {done}", **report)
    save_checkpoint(out, trainer.state(), {"step": done, "seconds": spent}, identity)
    model = out / "model.safetensors"
    training = {"steps": done, "seconds": round(spent, 2), "poses": len({(v.sequence, v.frame) for v in dataset.views}),
                "views": len(dataset.views), "data": run.data_statement,
                "finished": not progress.cancelled_by_user}  # fmt: skip
    save_actor(model, trainer.actor(), run.method, {"preset": run.preset, **settings}, training)
    if progress.cancelled_by_user:
        progress.cancelled(model=str(model), step=done)
    else:
        progress.result(model=str(model), steps=done, seconds=round(spent, 2))
    return model

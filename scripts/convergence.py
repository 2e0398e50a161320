"""Quality on views that training never sees, against seconds of training (preset ``fast``).

    python scripts/convergence.py --data DATA --format behave --train A,B --test C --minutes 1 --set grid_rate=0.01

Scoring takes no time from training; reading data and set-up are told apart.  Kernels must have been compiled before.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

from chona_model.process import tune

tune()  # before torch is imported

import numpy as np  # noqa: E402

from chona_model.data.dataset import Dataset, load_pixels  # noqa: E402
from chona_model.data.opener import open_dataset  # noqa: E402
from chona_model.evaluate.metrics import score  # noqa: E402
from chona_model.grid_actor import GridActor  # noqa: E402
from chona_model.settings import RENDER_PRESETS  # noqa: E402
from chona_model.train.grid_trainer import FastSettings, GridTrainer  # noqa: E402

MARKS = (5, 10, 15, 30, 60, 120, 180, 240, 300, 450, 600)
"""Seconds of training at which the model is scored."""


def with_changes(settings: FastSettings, changes: list[str]) -> FastSettings:
    """Settings with ``name=number`` changes.

    Raises:
        SystemExit: no such setting, or not a number.
    """
    known = {field.name for field in fields(settings) if isinstance(getattr(settings, field.name), int | float)}
    for change in changes:
        name, _, value = change.partition("=")
        if name not in known:
            raise SystemExit(f"'{name}' is no setting that is a number; those are: {', '.join(sorted(known))}")
        settings = replace(settings, **{name: type(getattr(settings, name))(float(value))})
    return settings


def held_out_score(trainer: GridTrainer, dataset: Dataset, count: int, preset: str) -> tuple[float, float]:
    """Mean PSNR of some views, whole and inside the masks' box, dB."""
    for index in range(len(trainer.model.persons)):
        trainer.model.volume(index).rendering_weights = None
    actor, rows = GridActor(trainer.model), []
    for index in np.linspace(0, len(dataset.views) - 1, count).astype(int):
        view = dataset.views[index]
        pixels = load_pixels(view)
        picture = actor.render(view.pose, view.camera, RENDER_PRESETS[preset])
        result = score(np.clip(picture.rgb, 0.0, 1.0), pixels.rgb, pixels.mask)
        rows.append((result.psnr, result.psnr_box if result.psnr_box is not None else result.psnr))
    return tuple(np.mean(rows, axis=0))


def main() -> int:
    """Prints a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--format", default="auto")
    parser.add_argument("--train", required=True, help="sequences, separated by commas")
    parser.add_argument("--test", required=True, help="sequences that training never sees")
    parser.add_argument("--minutes", type=float, default=1.0, help="length of the schedule")
    parser.add_argument("--views", type=int, default=8, help="how many of the test's views are scored")
    parser.add_argument("--preset", default="preview", choices=sorted(RENDER_PRESETS))
    parser.add_argument("--set", action="append", default=[], metavar="NAME=NUMBER", help="a setting of FastSettings")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    began = time.perf_counter()
    data, test = (
        open_dataset(options.data, options.format, sequences=names.split(","))
        for names in (options.train, options.test)
    )
    trainer = GridTrainer(data, with_changes(FastSettings(), options.set), options.seed)
    sys.stdout.write(f"set-up {time.perf_counter() - began:.1f} s; {' '.join(options.set) or 'defaults'}\n\n")
    sys.stdout.write("| seconds | steps | PSNR | in the masks' box |\n|---|---|---|---|\n")
    budget, spent, step = 60.0 * options.minutes, 0.0, 0
    for mark in (mark for mark in MARKS if mark <= budget):
        while spent < mark:
            start = time.perf_counter()
            trainer.step(step, min(spent / budget, 1.0))
            spent, step = spent + time.perf_counter() - start, step + 1
        whole, box = held_out_score(trainer, test, options.views, options.preset)
        sys.stdout.write(f"| {spent:.0f} | {step} | {whole:.2f} | {box:.2f} |\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Estimates and measurements: from the scene's settings to a job in the worker, and what is left of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy

from . import actions, estimates, model_cache, presets
from .bake_frames import checked_frames
from .blur import scene_blur
from .errors import ChonaError
from .jobs import Job
from .shot import sample_actors
from .shot_file import save_shot
from .shot_job import ShotJob
from .worker import chona_command

SECONDS = 2.0
"""How long a calibration renders."""

TOO_SLOW = {"exact": "final"}
"""A preset of which not one frame fits a calibration, and the one that is timed for it."""


class EstimateJob(ShotJob):
    """What times a bake; `facts` say what bake it was."""

    def __init__(
        self, title: str, command: Sequence[str], place: TemporaryDirectory[str], facts: estimates.Facts
    ) -> None:
        self.facts = facts
        super().__init__(title, command, place)


def start_estimate(scene: bpy.types.Scene) -> EstimateJob:
    """Write the shot as a bake would and have the worker time this computer on it."""
    settings = actions.settings_of(scene)
    plans = actions.actor_plans(scene)
    chosen, frames = presets.check(settings.preset), checked_frames(scene)
    python = actions.worker_python()
    place = TemporaryDirectory(prefix="chona_estimate_")
    shot = save_shot(Path(place.name) / "shot", sample_actors(scene, plans, frames, blur=scene_blur(scene)))
    arguments = ["estimate", "--model", str(plans[0].header.path.absolute()), "--shot", str(shot)]
    arguments += ["--preset", TOO_SLOW.get(chosen, chosen), "--seconds", f"{SECONDS:g}", *actions.device()]
    return EstimateJob("Estimate", chona_command(python, arguments), place, estimates.facts_of(scene))


def keep_estimate(scene: bpy.types.Scene, job: EstimateJob) -> list[str]:
    """Remember what a finished job has found. Returns a line for every preset."""
    estimate = estimates.keep(scene, job.facts, job.result)
    actors = actions.settings_of(scene).used_actors()
    header = model_cache.refresh(actors[0].model_path) if actors else None
    trade = None if header is None else header.trade
    return [estimates.sentence(name, trade, estimate) for name in estimate.presets]


def trade_folder(model: Path) -> Path:
    """Where measurements of a model are written: beside it."""
    return model.with_name(f"{model.stem}_trade")


def start_trade(scene: bpy.types.Scene) -> Job:
    """Have the worker measure the selected actor's model on the captures of the settings."""
    settings = actions.settings_of(scene)
    model = model_cache.load(settings.model_path).path.absolute()
    data = actions.data_folder(scene, "Speed and Quality")
    out = actions.writable_folder(str(trade_folder(model)), "folder for the measurements")
    arguments = ["trade", "--model", str(model), "--data", str(data), "--format", settings.data_format]
    arguments += ["--out", str(out), "--minutes", f"{settings.measure_minutes:g}", *actions.device()]
    if settings.measure_sequences.strip():
        arguments += ["--sequences", ",".join(actions.listed(settings.measure_sequences))]
    return Job(f"Measure {model.name}", chona_command(actions.worker_python(), arguments))


def trade_picture(scene: bpy.types.Scene) -> Path:
    """The plot of the last measurement of the selected actor's model; refused where there is none."""
    model = model_cache.load(actions.settings_of(scene).model_path).path
    picture = trade_folder(model) / "trade.png"
    if not picture.is_file():
        raise ChonaError(f"there is no plot {picture} yet; press Measure")
    return picture

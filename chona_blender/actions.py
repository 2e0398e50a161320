"""What operators and commands do: from the scene's settings to a running job. Errors are ChonaErrors."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import bpy

from . import compositing, diagnosis, model_cache, preferences, presets
from .bake_frames import checked_frames
from .bake_properties import KEEP, OVERWRITE, UPDATE
from .blur import scene_blur
from .compositing_options import options_of
from .detached_worker import DetachedWorker
from .errors import ChonaError
from .frames import describe_frames
from .job_record import bake_record
from .output import Output, absolute, bake_output
from .rig.armature import create_rig
from .rig.cast import ActorPlan
from .shot import sample_actors
from .shot_file import Shot, save_shot
from .shot_job import BakeJob
from .worker import chona_command, detached_command
from .worker_check import check_worker

if TYPE_CHECKING:
    from .actor_properties import CHONA_PG_actor
    from .properties import CHONA_PG_settings


EXISTING_OPTIONS: dict[str, list[str]] = {UPDATE: [], KEEP: ["--only-missing"], OVERWRITE: ["--overwrite"]}


@dataclass(frozen=True)
class Bake:
    """A bake that runs. `warnings` says what of the rig's scale and shear the model cannot follow."""

    job: BakeJob
    output: Output
    warnings: tuple[str, ...]


def settings_of(scene: bpy.types.Scene) -> CHONA_PG_settings:
    """The scene's CHONA settings."""
    return scene.chona


def writable_folder(path: str, what: str) -> Path:
    """The folder, made if need be, after something has been written into it for a test."""
    if not path.strip():
        raise ChonaError(f"no {what} is set; choose a folder")
    folder = absolute(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ChonaError(
            f"the {what} {folder} cannot be written ({error.strerror or error}); choose another one"
        ) from error
    return folder


def make_rig(scene: bpy.types.Scene, object_names: list[str] | None = None) -> str:
    """Make an armature and an empty for each object, and point the settings to them. Returns words for a report."""
    settings = settings_of(scene).ensure_actor()
    header = model_cache.load(settings.model_path)
    person = settings.person or next(iter(header.persons), "")
    names = list(header.objects) if object_names is None else object_names
    rig = create_rig(scene, header, person or None, names)
    settings.person = person
    settings.armature = rig.armature
    settings.set_objects({name: rig.empties[name] for name in names})
    made = [f"an armature of {len(header.names)} bones for {person}"] if rig.armature is not None else []
    made += [f"empties for {', '.join(names)}"] if names else []
    return f"Made {' and '.join(made)}"


def start_bake(scene: bpy.types.Scene, composite: bool = False, current: bool = False, detach: bool = False) -> Bake:
    """Check everything, write the shot beside the frames and start the worker on it.

    Args:
        composite: the frames are for the compositor, so what it needs must be among their passes.
        current: bake the scene's current frame alone, and leave the shot of the whole range as it is.
        detach: the worker goes on when Blender ends; not of the current frame alone, whose shot goes with Blender.
    """
    settings = settings_of(scene)
    if composite and not settings.passes.depth:
        raise ChonaError(
            "the frames are to be composited, but the pass Depth, by which that is done, is off; switch it on under "
            "Bake > Passes (in the command: --passes), or bake without compositing"
        )
    plans = actor_plans(scene)
    output = bake_output(scene)
    preset = presets.check(settings.preset)
    frames = [scene.frame_current] if current else checked_frames(scene)
    folder, name = writable_folder(str(output.folder), "output folder"), output.name
    python = worker_python()
    place = TemporaryDirectory(prefix="chona_frame_") if current else None
    shot = (Path(place.name) if place is not None else folder) / f"{name}.shot.npz"
    sampled = _sample(scene, plans, frames, name)
    save_shot(shot, sampled)
    arguments = ["bake", "--model", str(plans[0].header.path.absolute()), "--shot", str(shot), "--out", str(folder)]
    arguments += ["--passes", ",".join(settings.passes.names())]
    arguments += ["--preset", preset, *device(), *EXISTING_OPTIONS[settings.existing]]
    if settings.max_error > 0.0:
        arguments += ["--max-error", f"{settings.max_error:.6g}"]
    title = f"Bake {name} ({preset}, {describe_frames(frames)})"
    if detach:
        record = bake_record(folder, name)
        job = BakeJob(title, DetachedWorker.start(detached_command(python, arguments, record), record))
    else:
        job = BakeJob(title, chona_command(python, arguments), place)
    return Bake(job, output, tuple(f"{dropped} was dropped" for dropped in sampled.dropped))


def write_shot(scene: bpy.types.Scene) -> tuple[Path, tuple[str, ...]]:
    """Write the shot where a bake would, for baking elsewhere; its file, and what was dropped. Needs no worker."""
    plans, output = actor_plans(scene), bake_output(scene)
    frames = checked_frames(scene)
    folder = writable_folder(str(output.folder), "output folder")
    sampled = _sample(scene, plans, frames, output.name)
    path = save_shot(folder / f"{output.name}.shot.npz", sampled)
    return path, tuple(f"{dropped} was dropped" for dropped in sampled.dropped)


def _sample(scene: bpy.types.Scene, plans: list[ActorPlan], frames: list[int], name: str) -> Shot:
    sampled, settings = sample_actors(scene, plans, frames, name, blur=scene_blur(scene)), settings_of(scene)
    if settings.max_error > 0.0 and "blur.samples" in sampled.arrays:
        raise ChonaError(
            f"Max Error is {settings.max_error:g}, but it bounds sharp frames and these are blurred; set it to 0 and "
            "raise the samples under Motion Blur and Depth of Field, or switch both off there"
        )
    return sampled


def error_words(result: dict[str, Any]) -> str:
    """What a bake with an error bound has reached, from the worker's result; nothing without a bound."""
    bound = result.get("max_error")
    if bound is None:
        return ""
    if bound["unsettled"]:
        many = f"{bound['unsettled']} of {bound['pixels']} pixels"
        return f"; {many} still change by more than {bound['asked']:g}, up to {bound['error']:.3g}"
    return f"; every pixel within {bound['asked']:g} ({bound['error']:.3g} reached)"


def actor_plans(scene: bpy.types.Scene) -> list[ActorPlan]:
    """Everybody that is rendered, after a look at whether there is anybody at all."""
    settings = settings_of(scene)
    actors = settings.used_actors()
    if not actors:
        model_cache.load(settings.model_path)  # where no model is set, that is what is wrong
        raise ChonaError("there is nothing to render: every actor is switched off; switch one on under Rig")
    return [actor_plan(actor) for actor in actors]


def actor_plan(actor: CHONA_PG_actor) -> ActorPlan:
    """What one actor's settings ask for; refused where something is missing."""
    plan = plan_as_set(actor)
    if actor.person and actor.armature is None:
        raise ChonaError(f"no armature poses {actor.person}; press Create Rig, or choose an armature under Rig")
    if actor.person and not actor.armature.users_scene:  # deleted ones stay while somebody points at them
        raise ChonaError(f"the armature {actor.armature.name!r} was deleted; undo that, or choose another under Rig")
    objects = list(actor.used_objects())
    if not actor.person and not objects:
        raise ChonaError("there is nothing to render: neither a person nor an object is chosen; choose one under Rig")
    for item in objects:
        if item.empty is None or not item.empty.users_scene:
            raise ChonaError(
                f"object {item.name!r} has no empty that moves it; choose one under Rig, or switch the object off"
            )
    return plan


def plan_as_set(actor: CHONA_PG_actor) -> ActorPlan:
    """What one actor's settings ask for, also where something is missing."""
    header = model_cache.load(actor.model_path)
    empties = {item.name: item.empty for item in actor.used_objects()}
    person, legs = actor.person or None, actor.root_path == "LEGS"
    return ActorPlan(header, person, actor.armature, empties, actor.chosen_bones(), legs, actor.name)


def data_folder(scene: bpy.types.Scene, panel: str) -> Path:
    """The folder with the captures, refused where it is not there; `panel` is where to choose it."""
    given = settings_of(scene).data_folder
    if not given.strip():
        raise ChonaError(f"no data folder is set; choose the folder with the captures under {panel}")
    data = absolute(given)
    if not data.is_dir():
        raise ChonaError(f"there is no data folder {data}; choose the folder with the captures under {panel}")
    return data


def listed(text: str) -> list[str]:
    """The names in `a, b`."""
    return [part.strip() for part in text.split(",") if part.strip()]


def add_composite(scene: bpy.types.Scene, output: Output | None = None) -> compositing.CompositeResult:
    """Show the baked frames in the scene's compositor: those of ``output``, or where the scene would bake to now."""
    output = output or bake_output(scene)
    return compositing.add_layer(scene, output.folder, output.name, options_of(scene))


def remove_composite(scene: bpy.types.Scene) -> bool:
    """Take the settings' layer out of the compositor; True when there was one."""
    return compositing.remove_layer(scene, bake_output(scene).name)


def worker_python() -> Path:
    """The worker's Python after a quick look at what it has; what is wrong is kept for the report."""
    report = check_worker(preferences.worker_python(), load=False, seconds=60.0)
    if not report.good:
        diagnosis.worker_report = report
        raise ChonaError(report.summary)
    return report.python


def device() -> list[str]:
    """Arguments for the device that the user has chosen."""
    chosen = preferences.device()
    return [] if chosen == "auto" else ["--device", chosen]

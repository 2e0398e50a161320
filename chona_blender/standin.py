"""Making, keeping and removing an actor's stand-in: what the operators and the command do. Errors are ChonaErrors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import bpy
import numpy as np

from . import actions, jobs, standin_mesh
from .errors import ChonaError
from .rig.cast import Cast, cast
from .rig.driver import Driver
from .rig.validation import figure_scale
from .standin_bind import bind, rest_frames
from .standin_figure import make_figure_rig
from .standin_file import PartMesh, read_stand_in
from .worker import chona_command

if TYPE_CHECKING:
    from .actor_properties import CHONA_PG_actor


class StandInJob(jobs.Job):
    """A worker that makes meshes; ``scene`` and ``number`` say whose, ``facts`` what they were made of."""

    def __init__(
        self, title: str, command: Sequence[str], place: TemporaryDirectory[str], owner: tuple[str, int], facts: object
    ) -> None:
        self.place, self.facts = place, facts
        self.scene, self.number = owner
        super().__init__(title, command)

    @property
    def file(self) -> Path:
        """What the worker writes."""
        return Path(self.place.name) / "stand-in.npz"

    @property
    def text(self) -> str:
        """What is being done instead of a count: parts of a hundred say nothing."""
        if self.status != jobs.RUNNING or self.worker.cancelled_at is not None or self.eta is None:
            return super().text
        return f"{self.words}, {jobs.duration(self.eta)} left"

    def poll(self) -> bool:
        """As every job's; what a job that failed has left goes at once."""
        ended = super().poll()
        if ended and self.status != jobs.DONE:
            self.place.cleanup()
        return ended


def start_stand_in(scene: bpy.types.Scene, actor: CHONA_PG_actor) -> StandInJob:
    """Checks all that can be wrong with the rig and starts the worker."""
    plan = actions.actor_plan(actor)
    found = cast(plan)
    if found.driver is not None:
        rest_frames(found.driver, np.array(plan.armature.matrix_world, dtype=np.float64))
    python = actions.worker_python()
    place = TemporaryDirectory(prefix="chona_stand_in_")
    arguments = ["stand-in", "--model", str(plan.header.path.absolute()), "--voxel", f"{actor.stand_in.voxel:.6g}"]
    arguments += ["--out", str(Path(place.name) / "stand-in.npz"), *actions.device()]
    if plan.person is not None:
        arguments.append(f"--person={plan.person}")
    if found.object_names:
        arguments.append(f"--objects={','.join(found.object_names)}")
    owner = (scene.name, list(scene.chona.actors).index(actor))
    command = chona_command(python, arguments)
    return StandInJob(f"Make Stand-In of {plan.label}", command, place, owner, _facts(found))


def finish_stand_in(job: StandInJob) -> list[bpy.types.Object]:
    """Builds or replaces the meshes of a job that is done; settings, materials and modifiers of the user's stay.

    Raises:
        ChonaError: the actor was changed meanwhile, or the rig cannot carry the mesh.
    """
    try:
        scene = bpy.data.scenes.get(job.scene)
        if scene is None or job.number >= len(scene.chona.actors):
            raise ChonaError("the actor was removed while its stand-in was made; press Make Stand-In again")
        actor = scene.chona.actors[job.number]
        found = cast(actions.actor_plan(actor))
        if _facts(found) != job.facts:
            raise ChonaError("the actor was changed while its stand-in was made; press Make Stand-In again")
        return build(scene, actor, found, read_stand_in(job.file, len(found.plan.header.names)))
    finally:
        job.place.cleanup()


def make_stand_in(
    scene: bpy.types.Scene, actor: CHONA_PG_actor, progress: Callable[[jobs.Job], None] | None = None
) -> list[bpy.types.Object]:
    """Makes an actor's stand-in and waits for it: the mesh objects, the person's first.

    Raises:
        ChonaError: what is missing or wrong; also when the worker fails or is cancelled.
    """
    job = start_stand_in(scene, actor)
    jobs.run_blocking(job, progress)
    if job.status != jobs.DONE:
        raise ChonaError(job.error)
    return finish_stand_in(job)


def stand_ins(actor: CHONA_PG_actor) -> list[bpy.types.Object]:
    """The actor's mesh objects that are in the file; none where no stand-in was made."""
    return actor.stand_in.present()


def set_use(actor: CHONA_PG_actor, use: str) -> None:
    """What renders see of the stand-in: ``VIEWPORT``, ``SHADOW``, ``HOLDOUT`` or ``VISIBLE``."""
    actor.stand_in.use = use


def remove_stand_in(actor: CHONA_PG_actor) -> int:
    """Removes the actor's meshes and all that came with them; how many objects there were."""
    items = [part.object for part in actor.stand_in.parts if part.object is not None]
    actor.stand_in.parts.clear()
    standin_mesh.remove_objects([*items, *_without_figure(actor)])
    return len(items)


def build(
    scene: bpy.types.Scene, actor: CHONA_PG_actor, found: Cast, parts: Sequence[PartMesh]
) -> list[bpy.types.Object]:
    """Mesh objects of an actor; those of parts that it has no longer are removed."""
    driver, to_figure = found.driver, actor.stand_in.follow == "FIGURE"
    bindings = [
        bind(driver, part, to_figure=to_figure) if part.kind == "person" and driver is not None else None
        for part in parts
    ]
    scale = _scale(found)
    kept = {part.name: part.object for part in actor.stand_in.parts if part.object is not None}
    made = []
    for part, binding in zip(parts, bindings, strict=True):
        item = _object(scene, actor, kept.pop(part.name, None), part)
        standin_mesh.fill(item, part, part.vertices if binding is None else binding.vertices)
        if binding is not None:
            figure = _figure(scene, actor, driver) if to_figure else None
            standin_mesh.attach_to_armature(item, found.plan.armature, binding, figure)
        else:
            standin_mesh.attach_to_object(item, found.plan.objects[part.name], scale)
        made.append(item)
    actor.stand_in.parts.clear()
    for part, item in zip(parts, made, strict=True):
        entry = actor.stand_in.parts.add()
        entry.name, entry.object = part.name, item
    standin_mesh.remove_objects([*kept.values(), *([] if to_figure else _without_figure(actor))])
    return made


def _figure(scene: bpy.types.Scene, actor: CHONA_PG_actor, driver: Driver) -> bpy.types.Object:
    """The armature of the figure's own proportions, made or brought up to date."""
    item = actor.stand_in.figure
    if item is None:
        item = actor.stand_in.figure = standin_mesh.new_armature(f"{actor.label} Figure")
    if not item.users_collection:
        standin_mesh.collection_of(scene).objects.link(item)
    make_figure_rig(driver, item)
    return item


def _without_figure(actor: CHONA_PG_actor) -> list[bpy.types.Object]:
    """Lets go of the armature of the figure's own proportions: what is to be removed."""
    item, actor.stand_in.figure = actor.stand_in.figure, None
    return [] if item is None else [item]


def _object(
    scene: bpy.types.Scene, actor: CHONA_PG_actor, item: bpy.types.Object | None, part: PartMesh
) -> bpy.types.Object:
    """The object that is there, linked again where it was deleted; else a new one with the panel's settings."""
    if item is None or item.data is None or item.type != "MESH":
        item = standin_mesh.new_object(scene, f"{part.name} Stand-In", part.name)
        actor.stand_in.apply_use(item)
        actor.stand_in.apply_proxy(item)
    elif not item.users_collection:
        standin_mesh.collection_of(scene).objects.link(item)
    return item


def _scale(found: Cast) -> float:
    """Metres of the world in a metre of the model, as a bake has it."""
    if found.driver is not None:
        return rest_frames(found.driver, np.array(found.plan.armature.matrix_world, dtype=np.float64))[1]
    return figure_scale(np.array([[np.array(item.matrix_world)[:3, :3] for item in found.subject.objects]])) or 1.0


def _facts(found: Cast) -> object:
    """What a stand-in is made of and hung on: of a job that runs meanwhile nothing of it may change."""
    plan = found.plan
    return str(plan.header.path), plan.person, found.object_names

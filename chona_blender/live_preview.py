"""The live preview: while it is on, the pose and camera of the scene are rendered by a worker that stays up.

A timer calls `tick`: it samples, asks the worker and takes its pictures. Nothing of Blender's is kept between two
ticks, so undo and deletion cannot leave a dead pointer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from . import actions, preferences
from .areas import redraw_areas
from .camera import ImageFormat, image_format
from .errors import ChonaError
from .live_facts import Facts, facts_of
from .live_frames import Frame
from .live_kept import Stamp, kept_models, kept_worker
from .live_pace import STAGES, Pace
from .live_view import Canvas, Picture, camera_frame, camera_views, depsgraph_of, redraw_views
from .live_worker import LiveWorker
from .messages import sentence
from .rig.cast import ActorPlan
from .scenes import scene_of
from .shot import sample_actors_now
from .shot_file import Shot, shot_bytes
from .worker import find_python

TICK_SECONDS = 1.0 / 30.0
WAITING_SECONDS = 0.01
"""Between ticks while a picture is on its way: it is shown sooner, and nothing else is done."""

SAMPLING_SHARE = 0.25
"""Of the window's time, at most: a scene with many actors is sampled less often."""

LOOK_SECONDS = 0.25
"""Between looks at what Blender's handlers do not tell of."""

LOADING = "loading the model"
WAITING = "waiting for the worker"
START_AGAIN = "press Start Again"
NO_CAMERA = "The scene has no camera: add one and make it active"


@dataclass(frozen=True)
class Asked:
    """A request under way: its number, its stage, when the pose changed, and the pixels it was sampled for."""

    number: int
    stage: int
    changed: float
    image: ImageFormat


class LivePreview:
    """At most one, for one scene. All methods are for Blender's main thread, `tick` for its timer or a test."""

    def __init__(self) -> None:
        self.canvas = Canvas()
        self.error = ""
        self._scene: int | None = None
        self._worker: LiveWorker | None = None
        self._served: Path | None = None
        self._reset()

    def _reset(self) -> None:
        self._changed: float | None = None
        self._touched = 0.0
        self._sample_from = self._look_from = 0.0
        self._shot: Shot | None = None
        self._models: tuple[Stamp, ...] = ()
        self._facts: Facts = ()
        self._asked: Asked | None = None
        self._shown = 0
        self._pace = Pace()

    @property
    def is_on(self) -> bool:
        """Whether the preview is switched on, for whatever scene."""
        return self._scene is not None

    def is_on_for(self, scene: bpy.types.Scene) -> bool:
        """Whether it is a scene's preview that is switched on."""
        return self._scene == scene.session_uid

    @property
    def stopped(self) -> bool:
        """Whether the worker has ended by itself, and `live_kept.start_again` is what helps."""
        return self._worker is not None and not self._worker.alive and bool(self._worker.error)

    def on(self, scene: bpy.types.Scene) -> None:
        """Switch on and start the worker, if none is warm.

        Raises:
            ChonaError: nothing to render, no model, or the worker does not start; the preview stays off.
        """
        self.off()
        self._worker, self._served = _worker(actions.actor_plans(scene))
        self._scene = scene.session_uid
        self._reset()
        self.touch(scene)
        self.canvas.on(scene)

    def off(self) -> None:
        """Switch off; the worker stays warm for a while. Harmless when it is off."""
        self.canvas.off()
        if self._worker is not None:
            self._worker.rest()
        self._worker = self._scene = None
        self.error = ""
        self._reset()

    def touch(self, scene: bpy.types.Scene | None) -> None:
        """Something of a scene changed, or of any with None. Called by handlers, also while something renders."""
        if self._scene is None or (scene is not None and scene.session_uid != self._scene):
            return
        self._touched = time.monotonic()
        if self._changed is None:
            self._changed = self._touched

    def tick(self) -> float | None:
        """One step: take what has come, ask for what is wanted. Returns the seconds to the next one, None when off."""
        if self._scene is None:
            return None
        scene = scene_of(self._scene)
        if scene is None:
            self.off()
            return None
        if bpy.app.is_job_running("RENDER"):  # the render's own thread changes frames: nothing is evaluated beside it
            return TICK_SECONDS
        try:
            self._step(scene)
        except ChonaError as error:
            self._changed = self._shot = self._asked = None
            self._show(scene, None)
            self._tell(scene, sentence(error), alert=True)
        return WAITING_SECONDS if self._worker is not None and self._worker.busy else TICK_SECONDS

    def _step(self, scene: bpy.types.Scene) -> None:
        worker = self._worker
        frame = None if worker is None else worker.newest()
        if frame is not None and self._asked is not None and frame.number == self._asked.number > self._shown:
            self._take(scene, frame, self._asked)
        if worker is not None and worker.error:
            self._tell_of_worker(scene, worker)
        if scene.camera is None:
            self._facts = ()  # with a camera again, whatever it shows is new
            raise ChonaError(NO_CAMERA)
        views = [camera_frame(region, view, scene) for region, view in camera_views(scene)]
        widths = [frame.width for frame in views if frame is not None]
        if not widths:
            if self.error == NO_CAMERA:
                self._tell(scene, "")
            return
        now = time.monotonic()
        if now >= self._look_from:
            self._look_from = now + LOOK_SECONDS
            self._look(scene)
        if worker is not None and worker.alive and worker.busy:
            self._doubt(scene, now)
        elif self._changed is not None and now >= self._sample_from:
            self._follow(scene)
        elif self._changed is None and worker is not None and worker.ready and not worker.error:
            self._refine(max(widths))

    def _look(self, scene: bpy.types.Scene) -> None:
        before, self._facts = self._facts, facts_of(scene)
        if before != self._facts:
            self.touch(scene)

    def _doubt(self, scene: bpy.types.Scene, now: float) -> None:
        """While a picture takes long, hide the one before if the figure has moved on: it must not stand still there."""
        asked = self._asked
        moved = asked is not None and asked.stage == 0 and asked.number > self._shown
        since = asked.changed if asked is not None and moved else self._changed
        if self.canvas.is_empty or since is None or now - since < self._pace.patience:
            return
        if not moved:  # a better picture of a pose at rest is under way, and something has changed: perhaps the pose
            if now < self._sample_from or self._shot is None:
                return
            moved = not _same(self._sample(scene, actions.actor_plans(scene)), self._shot)
        if moved:
            self._show(scene, None)
            self._tell(scene, WAITING)
        else:
            self._changed = None

    def _follow(self, scene: bpy.types.Scene) -> None:
        """Sample the scene and ask for a draft, if it shows something else than before."""
        plans = actions.actor_plans(scene)
        worker, self._served = _worker(plans)
        if worker is not self._worker:
            self._show(scene, None)  # of another model, or of a pose that is gone
        if worker is not self._worker or kept_models() != self._models:
            self._shot = self._asked = None
        self._worker, self._models = worker, kept_models()
        if not worker.ready:
            if worker.alive:
                self._tell(scene, LOADING)
            else:
                self._changed = None
            return
        shot = self._sample(scene, plans)
        changed, self._changed = self._changed, None
        if self._shot is not None and self._asked is not None and _same(shot, self._shot):
            return
        self._shot = shot
        image = image_format(scene)
        self._ask(0, self._pace.scale(0, image, 0.0), changed or self._touched, image)

    def _sample(self, scene: bpy.types.Scene, plans: list[ActorPlan]) -> Shot:
        began = time.monotonic()
        try:
            return sample_actors_now(scene, depsgraph_of(scene), plans, self._served)
        finally:
            ended = time.monotonic()
            self._sample_from = ended + (ended - began) * (1.0 / SAMPLING_SHARE - 1.0)

    def _refine(self, width: float) -> None:
        """Ask for the next stage of a pose that rests, at the size of a camera frame `width` pixels wide."""
        asked = self._asked
        stage = len(STAGES) if asked is None else asked.stage + 1
        if asked is None or stage >= len(STAGES) or time.monotonic() - self._touched < STAGES[stage].idle:
            return
        self._ask(stage, self._pace.scale(stage, asked.image, width), asked.changed, asked.image)

    def _ask(self, stage: int, scale: float, changed: float, image: ImageFormat) -> None:
        if self._worker is None or self._shot is None:
            return
        number = self._worker.ask(shot_bytes(self._shot), STAGES[stage].preset, scale)
        self._asked = Asked(number, stage, changed, image)

    def _take(self, scene: bpy.types.Scene, frame: Frame, asked: Asked) -> None:
        """Learn how long a stage takes, and show its picture, unless it refines a pose that the figure has left."""
        self._shown = frame.number
        height, width = frame.depth.shape
        self._pace.learn(asked.stage, frame.seconds, width * height)
        now = time.monotonic()
        if asked.stage > 0 and self._changed is not None and now - self._changed > self._pace.patience:
            return
        self._show(scene, Picture(frame.rgba, asked.image))
        seconds = now - asked.changed
        took = f"{1000.0 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"
        self._tell(scene, f"{frame.preset}   {width} × {height}   {took}")

    def _show(self, scene: bpy.types.Scene, picture: Picture | None) -> None:
        if picture is not None or not self.canvas.is_empty:
            self.canvas.show(picture)
            redraw_views(scene)

    def _tell_of_worker(self, scene: bpy.types.Scene, worker: LiveWorker) -> None:
        """What the worker could not do; when it has ended its last picture goes, and how to go on is said too."""
        if worker.alive:
            self._tell(scene, sentence(ChonaError(worker.error)), alert=True)
        else:
            self._show(scene, None)
            self._tell(scene, f"{sentence(ChonaError(worker.error))}; {START_AGAIN}", alert=True)

    def _tell(self, scene: bpy.types.Scene, line: str, alert: bool = False) -> None:
        """Put words into the view's line, and errors into the panel; both are drawn again if need be."""
        error = line if alert else ""
        if (line, error) == (self.canvas.line, self.error):
            return
        self.canvas.line, self.canvas.alert = line, alert
        redraw_views(scene)
        if error != self.error:
            self.error = error
            redraw_areas("VIEW_3D")


def _same(one: Shot, other: Shot) -> bool:
    """Whether two shots give the same picture: all but the frame's number."""
    return one.header == other.header and all(
        np.array_equal(array, other.arrays.get(name)) for name, array in one.arrays.items() if name != "frames"
    )


def _worker(plans: list[ActorPlan]) -> tuple[LiveWorker, Path]:
    """The worker for the actors' models, and the one of these that it serves; the others the shot names."""
    python, _ = find_python(preferences.worker_python())
    models = dict.fromkeys(plan.header.path.absolute() for plan in plans)
    return kept_worker(python, tuple(models), preferences.device())

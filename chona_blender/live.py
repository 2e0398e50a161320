"""The live preview: while it is on, the pose and camera of the scene are rendered by a worker that stays up.

Handlers only note that something changed; a timer samples, asks the worker and takes its pictures. Nothing of Blender's
is kept between two ticks, so undo and deletion cannot leave a dead pointer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import bpy
import numpy as np

from . import actions, preferences
from .camera import ImageFormat, image_format
from .errors import ChonaError
from .jobs import redraw_sidebars, sentence
from .live_kept import close_kept, kept_worker
from .live_pace import STAGES, Pace
from .live_view import Canvas, Picture, camera_frame, camera_views
from .live_worker import Frame, LiveWorker
from .shot_file import Shot, shot_bytes
from .worker import find_python

TICK_SECONDS = 1.0 / 30.0
WAITING_SECONDS = 0.01
"""Between ticks while a picture is on its way: it is shown sooner, and nothing else is done."""

LOADING = "loading the model"


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
        self._reset()

    def _reset(self) -> None:
        self._changed: float | None = None
        self._touched = 0.0
        self._shot: Shot | None = None
        self._asked: Asked | None = None
        self._shown = 0
        self._pace = Pace()

    @property
    def is_on(self) -> bool:
        """Whether the preview is switched on, for whatever scene."""
        return self._scene is not None

    def on(self, scene: bpy.types.Scene) -> None:
        """Switch on and start the worker, if none is warm.

        Raises:
            ChonaError: no model, or the worker does not start; the preview stays off.
        """
        self.off()
        self._worker = _worker(scene)
        self._scene = scene.session_uid
        self._reset()
        self.touch(scene)
        for handlers, function in _HANDLERS:
            handlers.append(function)
        self.canvas.on(scene)
        bpy.app.timers.register(_tick, first_interval=TICK_SECONDS)

    def off(self) -> None:
        """Switch off; the worker stays warm for a while. Harmless when it is off."""
        if bpy.app.timers.is_registered(_tick):
            bpy.app.timers.unregister(_tick)
        for handlers, function in _HANDLERS:
            if function in handlers:
                handlers.remove(function)
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
        scene = next((each for each in bpy.data.scenes if each.session_uid == self._scene), None)
        if scene is None:
            self.off()
            return None
        if bpy.app.is_job_running("RENDER"):
            return TICK_SECONDS
        try:
            self._step(scene)
        except ChonaError as error:
            self._changed = self._shot = self._asked = None
            self.canvas.show(None)
            self._tell(scene, sentence(error), alert=True)
        return WAITING_SECONDS if self._worker is not None and self._worker.busy else TICK_SECONDS

    def _step(self, scene: bpy.types.Scene) -> None:
        worker = self._worker
        frame = None if worker is None else worker.newest()
        if frame is not None and self._asked is not None and frame.number == self._asked.number > self._shown:
            self._take(scene, frame, self._asked)
        if worker is not None and worker.error:
            self._tell(scene, sentence(ChonaError(worker.error)), alert=True)
        views = [camera_frame(region, view, scene) for region, view in camera_views(scene)]
        widths = [frame.width for frame in views if frame is not None]
        if not widths or (worker is not None and worker.alive and worker.busy):
            return
        if self._changed is not None:
            self._follow(scene)
        elif worker is not None and worker.ready and not worker.error and self._shot is not None:
            self._refine(max(widths))

    def _follow(self, scene: bpy.types.Scene) -> None:
        """Sample the scene and ask for a draft, if it shows something else than before."""
        worker = _worker(scene)
        known, self._worker = worker is self._worker, worker
        if not worker.ready:
            if worker.alive:
                self._tell(scene, LOADING)
            else:
                self._changed = None
            return
        shot = actions.sample_now(scene, _depsgraph(scene))
        changed, self._changed = self._changed, None
        if known and self._shot is not None and self._asked is not None and _same(shot, self._shot):
            return
        self._shot = shot
        image = image_format(scene)
        self._ask(0, self._pace.scale(0, image, 0.0), changed or self._touched, image)

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
        """Show a picture, and learn how long its stage takes."""
        self._shown = frame.number
        height, width = frame.depth.shape
        self._pace.learn(asked.stage, frame.seconds, width * height)
        self.canvas.show(Picture(frame.rgba, asked.image))
        milliseconds = 1000.0 * (time.monotonic() - asked.changed)
        self._tell(scene, f"{frame.preset}   {width} × {height}   {milliseconds:.0f} ms")

    def _tell(self, scene: bpy.types.Scene, line: str, alert: bool = False) -> None:
        """Put words into the view's line, and errors into the panel; both are drawn again if need be."""
        error = line if alert else ""
        if (line, error) == (self.canvas.line, self.error):
            return
        self.canvas.line, self.canvas.alert = line, alert
        for region, _ in camera_views(scene):
            region.tag_redraw()
        if error != self.error:
            self.error = error
            redraw_sidebars(bpy.context)


def _same(one: Shot, other: Shot) -> bool:
    """Whether two shots give the same picture: all but the frame's number."""
    return one.header == other.header and all(
        np.array_equal(array, other.arrays.get(name)) for name, array in one.arrays.items() if name != "frames"
    )


def _worker(scene: bpy.types.Scene) -> LiveWorker:
    path = actions.settings_of(scene).model_path
    if not path.strip():
        raise ChonaError("no model file is set; choose one under Model")
    python, _ = find_python(preferences.worker_python())
    return kept_worker(python, actions.absolute(path), preferences.device())


def _depsgraph(scene: bpy.types.Scene) -> bpy.types.Depsgraph:
    """The evaluated depsgraph of the window that shows a scene; a timer has no context of its own."""
    window = next(each for each in bpy.context.window_manager.windows if each.scene == scene)
    with bpy.context.temp_override(window=window):
        return bpy.context.evaluated_depsgraph_get()


preview = LivePreview()


def _tick() -> float | None:
    return preview.tick()


@bpy.app.handlers.persistent
def _scene_changed(scene: bpy.types.Scene, *_: object) -> None:
    preview.touch(scene)


@bpy.app.handlers.persistent
def _history_moved(*_: object) -> None:
    preview.touch(None)


@bpy.app.handlers.persistent
def _file_closes(*_: object) -> None:
    stop()


_HANDLERS = (
    (bpy.app.handlers.depsgraph_update_post, _scene_changed),
    (bpy.app.handlers.frame_change_post, _scene_changed),
    (bpy.app.handlers.undo_post, _history_moved),
    (bpy.app.handlers.redo_post, _history_moved),
)
"""While it is on."""


def stop() -> None:
    """Switch the preview off and end its worker: another file is loaded, or the add-on goes."""
    preview.off()
    close_kept()


def register() -> None:
    """Listen for files that are loaded: a handler that took itself out of a list would hide the next one there."""
    bpy.app.handlers.load_pre.append(_file_closes)


def unregister() -> None:
    """Stop, and listen no more."""
    stop()
    bpy.app.handlers.load_pre.remove(_file_closes)

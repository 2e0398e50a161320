"""The one live preview, and what of Blender's calls it: handlers only note that something changed, a timer does the
rest.
"""

from __future__ import annotations

import bpy

from .live_kept import close_kept
from .live_preview import TICK_SECONDS, LivePreview

preview = LivePreview()


def switch_on(scene: bpy.types.Scene) -> None:
    """Preview a scene, and no longer another one.

    Raises:
        ChonaError: see `LivePreview.on`.
    """
    switch_off()
    preview.on(scene)
    for handlers, function in _HANDLERS:
        handlers.append(function)
    bpy.app.timers.register(_tick, first_interval=TICK_SECONDS)


def switch_off() -> None:
    """Preview nothing; the worker stays warm for a while. Harmless when it is off."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _listen_no_more()
    preview.off()


def stop() -> None:
    """Switch the preview off and end its worker: another file is loaded, or the add-on goes."""
    switch_off()
    close_kept()


def _listen_no_more() -> None:
    for handlers, function in _HANDLERS:
        if function in handlers:
            handlers.remove(function)


def _tick() -> float | None:
    try:
        seconds = preview.tick()
    except Exception:  # whatever it is, Blender drops the timer for it: what is left must not look switched on
        preview.off()
        _listen_no_more()
        raise
    if seconds is None:
        _listen_no_more()
    return seconds


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


def register() -> None:
    """Listen for files that are loaded: a handler that took itself out of a list would hide the next one there."""
    bpy.app.handlers.load_pre.append(_file_closes)


def unregister() -> None:
    """Stop, and listen no more."""
    stop()
    bpy.app.handlers.load_pre.remove(_file_closes)

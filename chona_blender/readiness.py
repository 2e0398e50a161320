"""Why nothing can be rendered yet, in the words of a button that is off. Waits for no file and evaluates nothing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import bpy

from . import model_cache

if TYPE_CHECKING:
    from .actor_properties import CHONA_PG_actor

NO_MODEL = "Choose a model file first"
NO_CAPTURES = "Choose the folder with the captures first"


def why_not_ready(scene: bpy.types.Scene) -> str:
    """What is missing for a picture of all actors that are switched on, the first thing to do first; or nothing."""
    return next(_obstacles(scene), "")


def _obstacles(scene: bpy.types.Scene) -> Iterator[str]:
    settings = scene.chona
    actors = settings.used_actors()
    if not any(actor.model_path for actor in settings.actors):
        yield NO_MODEL
    elif not actors:
        yield "Every actor is switched off: switch one on under Model"
    for actor in actors:
        whose = f"{actor.label}: " if len(settings.actors) > 1 else ""
        yield from (f"{whose}{words}" for words in _obstacles_of(actor))
    yield from _obstacles_of_camera(scene)


def _obstacles_of(actor: CHONA_PG_actor) -> Iterator[str]:
    if not actor.model_path:
        yield "Choose a model file, or switch the actor off"
        return
    model_cache.watch(actor.model_path)
    problem = model_cache.cached_error(actor.model_path)
    if problem:
        yield problem[:1].upper() + problem[1:]
    objects = list(actor.used_objects())
    header = model_cache.cached(actor.model_path)
    if header is not None:
        if actor.person and actor.person not in header.persons:
            yield f"The model has no person {actor.person}: choose one under Rig"
        strange = next((item.name for item in objects if item.name not in header.objects), None)
        if strange is not None:
            yield f"The model has no object {strange}: choose one under Rig, or switch the object off"
    if actor.person and actor.armature is None:
        yield f"Create a rig, or choose an armature for {actor.person}"
    elif not actor.person and not objects:
        yield "Choose a person or an object under Rig"
    bare = next((item.name for item in objects if item.empty is None), None)
    if bare is not None:
        yield f"Choose what moves the object {bare}, or switch the object off"
    if actor.person and actor.armature is not None and actor.armature.mode == "EDIT":
        yield f"Leave edit mode of {actor.armature.name} first"


def _obstacles_of_camera(scene: bpy.types.Scene) -> Iterator[str]:
    bound = [marker.camera for marker in scene.timeline_markers if marker.camera is not None]
    if scene.camera is None and not bound:
        yield "The scene has no camera: add one and make it active"
    for camera in dict.fromkeys([*bound, *([scene.camera] if scene.camera and not bound else [])]):
        if camera.type != "CAMERA":
            yield f"{camera.name} is the scene's camera and is none: choose a camera"
        elif camera.data.type not in {"PERSP", "ORTHO"}:
            yield f"Camera {camera.name} is neither perspective nor orthographic: change its lens type"

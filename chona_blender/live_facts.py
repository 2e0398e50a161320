"""What the live preview's picture depends on and Blender's handlers do not tell of: settings, and the render's size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from .live_kept import models_now

if TYPE_CHECKING:
    from .actor_properties import CHONA_PG_actor

Facts = tuple[object, ...]


def facts_of(scene: bpy.types.Scene) -> Facts:
    """Cheap enough to be asked several times a second; equal while nothing has changed."""
    render = scene.render
    border = (render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y)
    return (
        tuple(_of_actor(actor) for actor in scene.chona.actors),
        models_now(),
        (render.resolution_x, render.resolution_y, render.resolution_percentage),
        (render.pixel_aspect_x, render.pixel_aspect_y),
        border if render.use_border and render.use_crop_to_border else None,
    )


def _of_actor(actor: CHONA_PG_actor) -> Facts:
    objects = tuple((item.name, item.use, _number(item.empty)) for item in actor.objects)
    bones = tuple(item.target for item in actor.bones)
    return actor.use, actor.model_path, actor.person, _number(actor.armature), actor.root_path, objects, bones


def _number(item: bpy.types.Object | None) -> int:
    """Stands for an object: undo and deletion leave dead pointers, but no dead numbers."""
    return 0 if item is None else item.session_uid

"""A view layer that shows what of the scene is in front of the figure and nothing else, with its exact coverage.

In it the figure's stand-ins are holdouts, and behind them, at the figure's distance, so is a card that fills the
camera's view. Camera rays end there, so only what is in front of the figure costs time. Both cast no shadow and show
in no mirror; in all other view layers they are switched off.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import bpy

from .camera import scene_camera
from .compositing_group import MARK
from .compositing_shadow import KEPT
from .errors import ChonaError

CARD_HALF_SIZE = 1000.0
"""Metres; wider than any camera's view of a figure, small enough for single precision."""
RAYS = ("diffuse", "glossy", "transmission", "volume_scatter", "shadow")


@dataclass(frozen=True)
class Figure:
    """Where the figure of a bake is in the scene.

    Attributes:
        place: an object at the figure's distance from the camera.
        bone: the bone of `place` to take instead, when it is an armature; or empty.
        stand_ins: meshes in the figure's place.
    """

    place: bpy.types.Object
    bone: str = ""
    stand_ins: tuple[bpy.types.Object, ...] = ()


def front_layer(scene: bpy.types.Scene, name: str) -> bpy.types.ViewLayer | None:
    """The view layer of the bake `name`."""
    return next((layer for layer in scene.view_layers if layer.get(MARK) == name), None)


def make_front(scene: bpy.types.Scene, name: str, base: bpy.types.ViewLayer, figure: Figure) -> bpy.types.ViewLayer:
    """Make or update the view layer; `base` is the one that the picture comes from.

    Raises:
        ChonaError: there is no camera, or the timeline's markers switch between several.
    """
    camera = only_camera(scene)
    layer = front_layer(scene, name) or scene.view_layers.new(f"CHONA {name} front")
    layer[MARK] = name
    _copy_settings(base, layer)
    collection = _collection(scene, name)
    _empty(collection)
    _add_card(collection, camera, figure)
    for stand_in in figure.stand_ins:
        _add_holdout(collection, stand_in)
    flags = {entry.collection: entry for entry in _entries(base.layer_collection)}
    for entry in _entries(layer.layer_collection):
        given = flags.get(entry.collection)
        if given is not None:
            entry.exclude, entry.holdout, entry.indirect_only = given.exclude, given.holdout, given.indirect_only
    for other in scene.view_layers:
        for entry in _entries(other.layer_collection):
            if entry.collection == collection:
                entry.exclude, entry.holdout = other != layer, other == layer
    return layer


def remove_front(scene: bpy.types.Scene, name: str) -> None:
    """Remove the view layer with its card and holdouts."""
    collection = next((item for item in scene.collection.children if item.get(MARK) == name), None)
    if collection is not None:
        _empty(collection)
        bpy.data.collections.remove(collection)
    layer = front_layer(scene, name)
    if layer is not None:
        scene.view_layers.remove(layer)


def only_camera(scene: bpy.types.Scene) -> bpy.types.Object:
    """The camera of all frames.

    Raises:
        ChonaError: there is none, or the timeline's markers switch between several.
    """
    cameras = {marker.camera.name for marker in scene.timeline_markers if marker.camera is not None}
    if len(cameras) > 1:
        raise ChonaError(
            f"Edges: Refined follows one camera, but markers switch between {', '.join(sorted(cameras))}; composite "
            "with Edges: Depth, or render each camera's frames from a scene of its own"
        )
    return scene_camera(scene, scene.frame_current)


def _copy_settings(base: bpy.types.ViewLayer, layer: bpy.types.ViewLayer) -> None:
    """All that decides what is seen and how; no passes besides the picture."""
    pairs = [(base, layer)]
    if hasattr(base, "cycles"):
        pairs.append((base.cycles, layer.cycles))
    for source, target in pairs:
        for item in source.bl_rna.properties:
            if item.is_readonly or item.identifier in {"name", "use"} or item.identifier.startswith("active_"):
                continue
            is_pass = "pass" in item.identifier and item.type == "BOOLEAN"
            setattr(target, item.identifier, not is_pass and getattr(source, item.identifier))
    layer.use = layer.use_pass_combined = True


def _collection(scene: bpy.types.Scene, name: str) -> bpy.types.Collection:
    found = next((item for item in scene.collection.children if item.get(MARK) == name), None)
    if found is None:
        found = bpy.data.collections.new(f"CHONA {name} front")
        found[MARK] = name
        scene.collection.children.link(found)
    return found


def _empty(collection: bpy.types.Collection) -> None:
    for item in list(collection.objects):
        mesh = item.data
        bpy.data.objects.remove(item)
        if mesh.users == 0:
            bpy.data.meshes.remove(mesh)


def _entries(root: bpy.types.LayerCollection) -> Iterator[bpy.types.LayerCollection]:
    for child in root.children:
        yield child
        yield from _entries(child)


def _add_card(collection: bpy.types.Collection, camera: bpy.types.Object, figure: Figure) -> None:
    """A card across the camera's view that keeps the figure's distance."""
    size = CARD_HALF_SIZE
    mesh = bpy.data.meshes.new(f"{collection.name} card")
    mesh.from_pydata([(-size, -size, 0), (size, -size, 0), (size, size, 0), (-size, size, 0)], [], [(0, 1, 2, 3)])
    card = bpy.data.objects.new(mesh.name, mesh)
    _only_for_camera(card)
    collection.objects.link(card)
    card.parent = camera
    follow = card.constraints.new("COPY_LOCATION")
    follow.target = figure.place
    if figure.bone:
        follow.subtarget = figure.bone
    follow.use_x = follow.use_y = False
    follow.owner_space = follow.target_space = "CUSTOM"
    follow.space_object = camera


def _add_holdout(collection: bpy.types.Collection, stand_in: bpy.types.Object) -> None:
    """The same mesh in the same place, for the camera alone."""
    holdout = stand_in.copy()
    holdout.name = f"{collection.name} {stand_in.name}"
    if KEPT in holdout:  # what is to be given back to the stand-in itself
        del holdout[KEPT]
    _only_for_camera(holdout)
    collection.objects.link(holdout)


def _only_for_camera(item: bpy.types.Object) -> None:
    for ray in RAYS:
        setattr(item, f"visible_{ray}", False)
    item.visible_camera = True
    item.hide_render = item.is_holdout = False
    item.hide_select = item.hide_viewport = True

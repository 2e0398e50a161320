"""What had to be switched on in a scene for its first layer, and how that is put back when the last one goes."""

from __future__ import annotations

import json

import bpy

from .compositing_nodes import NEW
from .compositing_tree import current_tree, default_tree
from .errors import ChonaError

STATE = "chona_compositing"


def has_state(scene: bpy.types.Scene) -> bool:
    """Whether something is to be put back; quick enough for poll and draw."""
    return STATE in scene


def prepare(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """The scene's tree, made when there is none, with compositing on.

    Raises:
        ChonaError: scene or tree come from another file and cannot be changed here.
    """
    tree = current_tree(scene)
    for item, kind in ((scene, "scene"), (tree, "compositor tree")):
        if item is not None and (item.library is not None or item.override_library is not None):
            library = item.library or item.override_library.reference.library
            raise ChonaError(
                f"the {kind} {item.name} is linked from {library.filepath} and cannot be changed here; make it local "
                "first (ID Data > Make Local), or add the layer in that file"
            )
    if STATE not in scene:
        state = {
            "use_compositing": scene.render.use_compositing,
            "device": scene.render.compositor_device,
            "made_tree": tree is None,
        }
        if NEW:
            if tree is None:
                scene.compositing_node_group = default_tree(scene)
        else:
            state["use_nodes"] = scene.use_nodes
            scene.use_nodes = True
        scene[STATE] = json.dumps(state)
    scene.render.use_compositing = True
    if bpy.app.background:
        # The GPU compositor needs an OpenGL display; without one Blender aborts, and 5.2 has it as its default.
        scene.render.compositor_device = "CPU"
    tree = current_tree(scene)
    if tree is None:
        raise ChonaError(
            "the scene's compositor tree was taken away while a CHONA layer used it; give it back, or start a new one"
        )
    return tree


def switch_depth_on(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Switch a view layer's Z pass on, and remember it."""
    if not view_layer.use_pass_z:
        state = json.loads(scene[STATE])
        state.setdefault("z_off", []).append(view_layer.name)
        scene[STATE] = json.dumps(state)
        view_layer.use_pass_z = True
        view_layer.update()


def restore(scene: bpy.types.Scene) -> None:
    """Put everything back. A tree of ours that the user has extended stays."""
    if STATE not in scene:
        return
    state = json.loads(scene[STATE])
    del scene[STATE]
    for name in state.get("z_off", []):
        view_layer = scene.view_layers.get(name)
        if view_layer is not None:
            view_layer.use_pass_z = False
    scene.render.use_compositing = state["use_compositing"]
    scene.render.compositor_device = state["device"]
    tree = current_tree(scene)
    if NEW:
        if state["made_tree"] and tree is not None and len(tree.nodes) == 2:
            scene.compositing_node_group = None
            if tree.users == 0:
                bpy.data.node_groups.remove(tree)
    else:
        # A tree that exists once cannot be taken from the scene again in 4.5; switched off it is as good as none.
        scene.use_nodes = state["use_nodes"]

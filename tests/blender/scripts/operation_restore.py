"""Adds and removes layers in trees of several shapes; tells whether each is as it was. Argument: folder of frames."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import bpy
from operation_scene import describe_tree, empty_scene, say

from chona_blender import compositing

NEW = bpy.app.version >= (5, 0, 0)
frames = Path(sys.argv[1])


def user_tree(scene: bpy.types.Scene) -> tuple[bpy.types.NodeTree, bpy.types.NodeSocket]:
    """An empty tree with an output, as a user would have it."""
    if NEW:
        tree = bpy.data.node_groups.new("mine", "CompositorNodeTree")
        scene.compositing_node_group = tree
        tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        return tree, tree.nodes.new("NodeGroupOutput").inputs["Image"]
    scene.use_nodes = True
    scene.node_tree.nodes.clear()
    return scene.node_tree, scene.node_tree.nodes.new("CompositorNodeComposite").inputs["Image"]


def nothing(scene: bpy.types.Scene) -> None:
    """The compositor was never used."""


def plain(scene: bpy.types.Scene) -> None:
    """Render Layers to output."""
    tree, output = user_tree(scene)
    tree.links.new(tree.nodes.new("CompositorNodeRLayers").outputs["Image"], output)


def graded(scene: bpy.types.Scene) -> None:
    """A grade, a viewer on the same socket, a muted node and a loose one."""
    tree, output = user_tree(scene)
    layers, exposure = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeExposure")
    exposure.inputs["Exposure"].default_value = 0.3
    exposure.label, exposure.location = "warm", (120.0, -40.0)
    viewer, loose = tree.nodes.new("CompositorNodeViewer"), tree.nodes.new("CompositorNodeBlur")
    loose.mute = True
    tree.links.new(layers.outputs["Image"], exposure.inputs["Image"])
    tree.links.new(exposure.outputs["Image"], output)
    tree.links.new(exposure.outputs["Image"], viewer.inputs["Image"])


def without_render_layers(scene: bpy.types.Scene) -> None:
    """A tree that composites without the scene's own render."""
    tree, output = user_tree(scene)
    tree.links.new(tree.nodes.new("CompositorNodeExposure").outputs["Image"], output)


def unlinked(scene: bpy.types.Scene) -> None:
    """An output that nothing goes to."""
    user_tree(scene)


def unlinked_with_layers(scene: bpy.types.Scene) -> None:
    """The same beside Render Layers with the Z pass on already."""
    tree, _ = user_tree(scene)
    tree.nodes.new("CompositorNodeRLayers")
    scene.view_layers[0].use_pass_z = True


def state(scene: bpy.types.Scene) -> dict:
    """What removal has to bring back."""
    tree = compositing.current_tree(scene)
    in_use = NEW or scene.use_nodes
    return {
        "tree": describe_tree(tree) if in_use else None,
        "z": [layer.use_pass_z for layer in scene.view_layers],
        "compositing": scene.render.use_compositing,
        "device": scene.render.compositor_device,
        "groups": sorted(group.name for group in bpy.data.node_groups),
        "images": sorted(image.name for image in bpy.data.images if image.type != "COMPOSITING"),
        "scene keys": sorted(key for key in tuple(scene.keys()) if key != "chona"),
    }


def run(build: Callable[[bpy.types.Scene], None], order: str) -> dict:
    """Add `walk` and `zero`, update `walk`, remove both in one order; what the tree held meanwhile."""
    scene = empty_scene()
    build(scene)
    before = state(scene)
    for name in ("walk", "zero", "walk"):
        compositing.add_layer(scene, frames, name)
    names = compositing.layer_names(scene)
    groups = sorted(
        group.name for group in bpy.data.node_groups if group.name.startswith("CHONA ") and "Comp" not in group.name
    )
    for name in ("walk", "zero") if order == "first" else ("zero", "walk"):
        compositing.remove_layer(scene, name)
    after = state(scene)
    return {"same": before == after, "before": before, "after": after, "names": names, "groups": groups}


shapes = (nothing, plain, graded, without_render_layers, unlinked, unlinked_with_layers)
say({f"{build.__name__}, {order}": run(build, order) for build in shapes for order in ("first", "last")})

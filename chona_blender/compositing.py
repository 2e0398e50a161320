"""Puts baked frames into the scene's compositor by depth, and takes them out again without a trace.

One node group `CHONA <name>` is inserted in the link that ends in the tree's output. Nodes that the user made are
never changed, moved or removed; what had to be switched on for the layer (Z pass, compositing) is remembered in the
scene and put back when the last layer goes. Several layers stack: each takes picture and depth from the one before
it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import bpy

from .camera import image_format
from .compositing_group import MARK, build_layer_group, set_sequence
from .errors import ChonaError
from .exr_header import read_exr_header
from .frames import BakedFrames, describe_frames, find_baked_frames

STATE = "chona_compositing"
UNLINKED = "chona_output_was_unlinked"
HAS_GROUP_OUTPUT = bpy.app.version >= (5, 0, 0)


@dataclass(frozen=True)
class CompositeResult:
    """What was built, in words for a report."""

    group: bpy.types.NodeTree
    frames: BakedFrames
    warnings: tuple[str, ...]

    @property
    def message(self) -> str:
        return f"{self.group.name}: {describe_frames(self.frames.numbers)}"


def layer_group_name(name: str) -> str:
    """The node group's name for the bake `name`."""
    return f"CHONA {name}"


def add_layer(scene: bpy.types.Scene, folder: Path, name: str) -> CompositeResult:
    """Make or update the layer that shows the bake `name` of `folder` in the scene."""
    frames = find_baked_frames(folder, name)
    if not frames.numbers:
        raise ChonaError(
            f"{name} has only frames below 0 and Blender's image sequences begin at 0; "
            "move the animation to frame 0 or later and bake it again"
        )
    header = read_exr_header(frames.path(frames.numbers[0]))
    image = image_format(scene)
    size = (image.width, image.height)
    if (header.width, header.height) != size:
        raise ChonaError(
            f"{name} was baked at {header.width} × {header.height} but the scene renders {size[0]} × {size[1]}; "
            "the compositor does not scale layers: bake again, or set the render resolution back"
        )
    if not header.layers:
        raise ChonaError(
            f"{frames.path(frames.numbers[0])} has no layer with a Combined pass; expected a frame that CHONA baked"
        )
    if f"{header.layers[0]}.Depth.Z" not in header.channels:
        raise ChonaError(
            f"{name} was baked without the pass 'depth', by which the compositor tells what is in front; bake it again "
            "with it (--passes combined,depth,mattes,confidence)"
        )

    tree = _tree(scene)
    group = _find_group(tree, name)
    if group is None:
        _free_orphans(name)
        group = build_layer_group(layer_group_name(name))
    set_sequence(group, frames, header.layers[0])
    group[MARK] = name
    if _group_node(tree, group) is None:
        _insert(scene, tree, group)
    return CompositeResult(group, frames, _warnings(frames))


def remove_layer(scene: bpy.types.Scene, name: str) -> bool:
    """Take the layer out; True when there was one."""
    tree = current_tree(scene)
    group = None if tree is None else _find_group(tree, name)
    if tree is None or group is None:
        left_over = has_layers(scene) and not layer_names(scene)  # the user has deleted the node by hand
        if left_over:
            _restore(scene)
        return left_over
    node = _group_node(tree, group)
    if node is not None:
        _bypass(tree, node)
        tree.nodes.remove(node)
        _remove_own_render_layers(tree)
    _free(group)
    if not layer_names(scene):
        _restore(scene)
    return True


def layer_names(scene: bpy.types.Scene) -> list[str]:
    """The bakes whose layers are in the scene's compositor."""
    tree = current_tree(scene)
    if tree is None:
        return []
    return [node.node_tree[MARK] for node in tree.nodes if _is_layer_node(node)]


def current_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """The compositor's node tree, or None where the scene has none."""
    return scene.compositing_node_group if HAS_GROUP_OUTPUT else scene.node_tree


def _warnings(frames: BakedFrames) -> tuple[str, ...]:
    words = []
    if frames.missing:
        count = len(frames.missing)
        are = "1 frame is missing" if count == 1 else f"{count} frames are missing"
        words.append(f"{are} between {frames.numbers[0]} and {frames.numbers[-1]} and will be empty")
    if frames.negative:
        words.append(f"{len(frames.negative)} frames below 0 are left out: Blender's image sequences begin at 0")
    return tuple(words)


def _tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """The scene's tree, made when there is none, with everything switched on that a layer needs."""
    if STATE not in scene:
        state = {
            "use_compositing": scene.render.use_compositing,
            "device": scene.render.compositor_device,
            "made_tree": False,
        }
        tree = current_tree(scene)
        if tree is not None and tree.library is not None:
            raise ChonaError(
                f"the compositor tree {tree.name} is linked from {tree.library.filepath}; make it local first"
            )
        if HAS_GROUP_OUTPUT:
            if tree is None:
                scene.compositing_node_group = _default_tree(scene)
                state["made_tree"] = True
        else:
            state["use_nodes"] = scene.use_nodes
            state["made_tree"] = tree is None
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


def _default_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """Render Layers to output, as Blender's own New button makes it."""
    tree = bpy.data.node_groups.new("CHONA Compositing", "CompositorNodeTree")
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layers = tree.nodes.new("CompositorNodeRLayers")
    layers.scene = scene
    output = tree.nodes.new("NodeGroupOutput")
    output.location = (600.0, 0.0)
    tree.links.new(layers.outputs["Image"], output.inputs[0])
    return tree


def _insert(scene: bpy.types.Scene, tree: bpy.types.NodeTree, group: bpy.types.NodeTree) -> None:
    target = _output_socket(tree)
    source = target.links[0].from_socket if target.links else None
    node = tree.nodes.new("CompositorNodeGroup")
    node.node_tree = group
    node.label = group.name
    node.width = 220.0
    node.location = (target.node.location.x - 260.0, target.node.location.y - 180.0)
    try:
        before = source.node if source is not None and _is_layer_node(source.node) else None
        if before is not None:
            depth = before.outputs["Depth"]
        else:
            layers = _render_layers(scene, tree, node)
            depth = layers.outputs["Depth"]
            if source is None:
                node[UNLINKED] = True
                source = layers.outputs["Image"]
        tree.links.new(source, node.inputs["Image"])
        tree.links.new(depth, node.inputs["Depth"])
        tree.links.new(node.outputs["Image"], target)
    except (RuntimeError, KeyError) as error:
        tree.nodes.remove(node)
        raise ChonaError(f"the layer could not be put into the compositor tree {tree.name}: {error}") from error


def _output_socket(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """The socket that the render's picture ends in."""
    kind = "NodeGroupOutput" if HAS_GROUP_OUTPUT else "CompositorNodeComposite"
    outputs = [node for node in tree.nodes if node.bl_idname == kind]
    outputs.sort(key=lambda node: not getattr(node, "is_active_output", True))
    for node in outputs:
        for socket in node.inputs:
            if socket.type == "RGBA":
                return socket
    raise ChonaError(
        f"the compositor tree {tree.name} has no output for the picture; "
        "add a Group Output node (in 4.5: Composite) with an Image"
    )


def _render_layers(scene: bpy.types.Scene, tree: bpy.types.NodeTree, node: bpy.types.Node) -> bpy.types.Node:
    """The Render Layers node whose depth is compared: the user's nearest one of this scene, else one of our own."""
    for candidate in tree.nodes:
        if candidate.bl_idname == "CompositorNodeRLayers" and candidate.scene == scene and not candidate.mute:
            found = candidate
            break
    else:
        found = tree.nodes.new("CompositorNodeRLayers")
        found.scene = scene
        found[MARK] = node.name
        found.location = (node.location.x - 320.0, node.location.y - 120.0)
    view_layer = scene.view_layers.get(found.layer) or scene.view_layers[0]
    if not view_layer.use_pass_z:
        state = json.loads(scene[STATE])
        state.setdefault("z_off", []).append(view_layer.name)
        scene[STATE] = json.dumps(state)
        view_layer.use_pass_z = True
        view_layer.update()
    return found


def _bypass(tree: bpy.types.NodeTree, node: bpy.types.Node) -> None:
    """Join what comes into the layer with what its picture and depth go to."""
    for name in ("Image", "Depth"):
        sources = [link.from_socket for link in node.inputs[name].links]
        targets = [link.to_socket for link in node.outputs[name].links]
        for target in targets:
            if name == "Image" and UNLINKED in node:
                if not _is_layer_node(target.node):
                    continue
                target.node[UNLINKED] = True
            if sources:
                tree.links.new(sources[0], target)


def _remove_own_render_layers(tree: bpy.types.NodeTree) -> None:
    """Remove Render Layers nodes of our making that no layer takes its depth from any more."""
    for node in list(tree.nodes):
        if node.bl_idname == "CompositorNodeRLayers" and MARK in node:
            followers = [link.to_node for output in node.outputs for link in output.links]
            if not any(_is_layer_node(follower) for follower in followers):
                tree.nodes.remove(node)


def _restore(scene: bpy.types.Scene) -> None:
    """Put back what `_tree` and `_render_layers` switched on. A tree of ours that the user has extended stays."""
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
    if HAS_GROUP_OUTPUT:
        if state["made_tree"] and tree is not None and len(tree.nodes) == 2:
            scene.compositing_node_group = None
            if tree.users == 0:
                bpy.data.node_groups.remove(tree)
    else:
        # A tree that exists once cannot be taken from the scene again in 4.5; switched off it is as good as none.
        scene.use_nodes = state["use_nodes"]


def _is_layer_node(node: bpy.types.Node) -> bool:
    return node.bl_idname == "CompositorNodeGroup" and node.node_tree is not None and MARK in node.node_tree


def _find_group(tree: bpy.types.NodeTree, name: str) -> bpy.types.NodeTree | None:
    return next((node.node_tree for node in tree.nodes if _is_layer_node(node) and node.node_tree[MARK] == name), None)


def _group_node(tree: bpy.types.NodeTree, group: bpy.types.NodeTree) -> bpy.types.Node | None:
    return next(
        (node for node in tree.nodes if node.bl_idname == "CompositorNodeGroup" and node.node_tree == group), None
    )


def _free_orphans(name: str) -> None:
    """Groups of this bake whose node the user has deleted by hand: nothing shows them any more."""
    for group in list(bpy.data.node_groups):
        if group.users == 0 and group.get(MARK) == name:
            _free(group)


def _free(group: bpy.types.NodeTree) -> None:
    """Remove the group and its image when nothing else uses them."""
    if group.users:
        return
    images = {node.image for node in group.nodes if node.bl_idname == "CompositorNodeImage" and node.image is not None}
    bpy.data.node_groups.remove(group)
    for image in images:
        if image.users == 0:
            bpy.data.images.remove(image)


def has_layers(scene: bpy.types.Scene) -> bool:
    """Whether a layer is in the scene's compositor; quick enough for poll and draw."""
    return STATE in scene

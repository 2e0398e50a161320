"""Where a layer's node sits in the user's compositor tree: found, put in, and bypassed again.

Nodes that the user made are never changed, moved or removed; of their links only those that end where the layer is put
in are led through it, and led back when it goes. Nodes of our making beside the layers carry a mark: the bake's name,
or `SHARED`.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from .compositing_group import FAR, MARK
from .compositing_nodes import NEW
from .errors import ChonaError

UNLINKED = "chona_output_was_unlinked"
SHARED = "*"
UNLINKED_VALUES = {"Depth": FAR, "Layers Depth": FAR, "Layers Alpha": 0.0}
RENDER_LAYERS = "CompositorNodeRLayers"


def current_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """The compositor's node tree, or None where the scene has none."""
    return scene.compositing_node_group if NEW else scene.node_tree


def default_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """Render Layers to output, as Blender's own New button makes it."""
    tree = bpy.data.node_groups.new("CHONA Compositing", "CompositorNodeTree")
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layers = tree.nodes.new(RENDER_LAYERS)
    layers.scene = scene
    output = tree.nodes.new("NodeGroupOutput")
    output.location = (600.0, 0.0)
    tree.links.new(layers.outputs["Image"], output.inputs[0])
    return tree


def is_layer_node(node: bpy.types.Node) -> bool:
    """Whether the node shows one of our layers."""
    return node.bl_idname == "CompositorNodeGroup" and node.node_tree is not None and MARK in node.node_tree


def layer_nodes(tree: bpy.types.NodeTree) -> list[bpy.types.Node]:
    """The nodes of all layers, the one that comes first in the picture first."""
    found = [node for node in tree.nodes if is_layer_node(node)]
    ordered: list[bpy.types.Node] = []
    while found:
        ready = [node for node in found if _before(node) not in found] or found
        ordered.append(ready[0])
        found.remove(ready[0])
    return ordered


def find_layer(tree: bpy.types.NodeTree, name: str) -> bpy.types.Node | None:
    """The node of the bake `name`."""
    return next((node for node in tree.nodes if is_layer_node(node) and node.node_tree[MARK] == name), None)


def insert(tree: bpy.types.NodeTree, group: bpy.types.NodeTree) -> bpy.types.Node:
    """Put a node of `group` behind the last layer, else in front of the tree's output.

    Raises:
        ChonaError: the tree has no output for a picture.
    """
    layers = layer_nodes(tree)
    target = None if layers else _output_socket(tree)
    node = tree.nodes.new("CompositorNodeGroup")
    node.node_tree = group
    node.label = group.name
    node.width = 220.0
    node.select = False
    if layers:
        last = layers[-1]
        node.location = (last.location.x + 260.0, last.location.y - 60.0)
        for name in ("Image", "Depth"):
            for link in list(last.outputs[name].links):
                _link(tree, node.outputs[name], link.to_socket, link.is_muted)
        _link(tree, last.outputs["Image"], node.inputs["Image"])
        return node
    node.location = (target.node.location.x - 260.0, target.node.location.y - 180.0)
    if target.links:
        old = target.links[0]
        _link(tree, old.from_socket, node.inputs["Image"], old.is_muted)
    else:
        node[UNLINKED] = True
    _link(tree, node.outputs["Image"], target)
    return node


def depth_sources(scene: bpy.types.Scene, tree: bpy.types.NodeTree) -> list[bpy.types.Node]:
    """The Render Layers nodes whose depth is compared, one for each view layer that the picture comes from.

    Their Z passes have to be on before `connect`. Without one upstream any of the user's nodes that shows this scene,
    else one of our own.
    """
    first = layer_nodes(tree)[0]

    def shows(node: bpy.types.Node) -> bool:
        ours = node.get(MARK, SHARED) != SHARED  # the front of another layer
        return node.bl_idname == RENDER_LAYERS and node.scene == scene and not node.mute and not ours

    found = [node for node in _upstream(first.inputs["Image"]) if shows(node)]
    found = found or [node for node in tree.nodes if shows(node)][:1]
    by_layer = {node.layer: node for node in reversed(found)}
    if by_layer:
        return list(reversed(by_layer.values()))
    made = mark(tree.nodes.new(RENDER_LAYERS), SHARED)
    made.scene = scene
    made.layer = next((layer.name for layer in scene.view_layers if layer.use), scene.view_layers[0].name)
    made.location = (first.location.x - 320.0, first.location.y - 120.0)
    return [made]


def connect(tree: bpy.types.NodeTree, node: bpy.types.Node, sources: list[bpy.types.Node]) -> None:
    """Give a layer's node depth, and what it needs to know of the layers before it; `sources` as `depth_sources`."""
    first, before = layer_nodes(tree)[0], _before(node)
    for name, value in UNLINKED_VALUES.items():
        node.inputs[name].default_value = value  # sockets that came to a node of an older version hold 0
    if not first.inputs["Image"].links:
        _link(tree, sources[0].outputs["Image"], first.inputs["Image"])
    if not node.inputs["Depth"].links:
        shared = first.inputs["Depth"].links
        _link(tree, shared[0].from_socket if shared else _nearest(tree, node, sources), node.inputs["Depth"])
    if before is not None:
        _link(tree, first.inputs["Image"].links[0].from_socket, node.inputs["Scene"])
        for name in ("Layers Alpha", "Layers Depth"):
            _link(tree, before.outputs[name], node.inputs[name])


def bypass(tree: bpy.types.NodeTree, node: bpy.types.Node) -> None:
    """Join what comes into the layer with what it goes to."""
    before = _before(node)
    incoming = node.inputs["Image"].links[0] if node.inputs["Image"].links else None
    for link in list(node.outputs["Image"].links):
        if UNLINKED in node:
            if not is_layer_node(link.to_node):
                continue
            link.to_node[UNLINKED] = True
        if incoming is not None:
            _link(tree, incoming.from_socket, link.to_socket, link.is_muted or incoming.is_muted)
    for name in ("Depth", "Layers Alpha", "Layers Depth"):
        source = before.outputs[name] if before is not None else None
        if source is None and name == "Depth" and node.inputs["Depth"].links:
            source = node.inputs["Depth"].links[0].from_socket
        if source is not None:
            for link in list(node.outputs[name].links):
                _link(tree, source, link.to_socket, link.is_muted)


def mark(node: bpy.types.Node, owner: str) -> bpy.types.Node:
    """Note that the node is ours: of the bake `owner`, or `SHARED` by all."""
    node[MARK] = owner
    node.select = False
    return node


def own_node(tree: bpy.types.NodeTree, kind: str, owner: str) -> bpy.types.Node | None:
    """The node that was marked so."""
    return next((node for node in tree.nodes if node.bl_idname == kind and node.get(MARK) == owner), None)


def remove_own_nodes(tree: bpy.types.NodeTree, name: str) -> None:
    """Remove the marked nodes of a bake, then the shared ones that lead nowhere any more."""
    for node in [node for node in tree.nodes if node.get(MARK) == name]:
        tree.nodes.remove(node)
    while True:
        idle = [node for node in tree.nodes if node.get(MARK) == SHARED and not any(s.links for s in node.outputs)]
        if not idle:
            return
        for node in idle:
            tree.nodes.remove(node)


def _link(
    tree: bpy.types.NodeTree, source: bpy.types.NodeSocket, target: bpy.types.NodeSocket, muted: bool = False
) -> None:
    made = tree.links.new(source, target)
    if muted:
        made.is_muted = True


def _before(node: bpy.types.Node) -> bpy.types.Node | None:
    """The nearest layer upstream of a layer; the user may have put nodes between them."""
    return next((other for other in _upstream(node.inputs["Image"]) if is_layer_node(other)), None)


def _upstream(socket: bpy.types.NodeSocket) -> Iterator[bpy.types.Node]:
    """Nodes that a picture comes from, nearest first."""
    waiting = [link.from_node for link in socket.links]
    seen: list[bpy.types.Node] = []
    while waiting:
        node = waiting.pop(0)
        if node in seen:
            continue
        seen.append(node)
        yield node
        waiting += [link.from_node for entry in node.inputs for link in entry.links]


def _output_socket(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """The socket that the render's picture ends in."""
    kind = "NodeGroupOutput" if NEW else "CompositorNodeComposite"
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


def _nearest(tree: bpy.types.NodeTree, node: bpy.types.Node, sources: list[bpy.types.Node]) -> bpy.types.NodeSocket:
    """The depth of what is nearest in several view layers."""
    depth = sources[0].outputs["Depth"]
    for number, source in enumerate(sources[1:], start=1):
        minimum = mark(tree.nodes.new("ShaderNodeMath"), SHARED)
        minimum.operation = "MINIMUM"
        minimum.label = "CHONA nearest depth"
        minimum.location = (node.location.x - 200.0, node.location.y - 180.0 * number)
        _link(tree, depth, minimum.inputs[0])
        _link(tree, source.outputs["Depth"], minimum.inputs[1])
        depth = minimum.outputs[0]
    return depth

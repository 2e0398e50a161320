"""Adds and removes layers in random trees of users, and tells what is not as it was. Arguments: frames, seeds."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import bpy
from operation_scene import empty_scene, say

from chona_blender import compositing
from chona_blender.compositing import CompositeOptions, Figure

NEW = bpy.app.version >= (5, 0, 0)
PICTURES = ("CompositorNodeExposure", "CompositorNodeBlur", "CompositorNodeAlphaOver", "NodeReroute", "ShaderNodeMix",
            "CompositorNodeSetAlpha", "CompositorNodeHueSat")  # fmt: skip
ENDS = ("CompositorNodeViewer", "CompositorNodeOutputFile")
OUTPUT = "NodeGroupOutput" if NEW else "CompositorNodeComposite"
frames = Path(sys.argv[1])


def plain(value: object) -> object:
    """A property's value as something that can be compared."""
    if isinstance(value, bpy.types.bpy_struct):
        return repr(value)
    if hasattr(value, "__len__") and not isinstance(value, str):
        return [plain(item) for item in value]
    return value


def properties(item: bpy.types.bpy_struct) -> dict[str, object]:
    """Everything that can be set on something."""
    names = (entry.identifier for entry in item.bl_rna.properties if not entry.is_readonly)
    return {name: plain(getattr(item, name)) for name in names}


def dump(scene: bpy.types.Scene) -> dict[str, object]:
    """All of the scene, its compositor and its data that a layer could leave a trace in."""
    tree = compositing.current_tree(scene)
    used = tree if NEW or scene.use_nodes else None
    nodes = used.nodes if used is not None else ()
    links = used.links if used is not None else ()
    return {
        "nodes": {node.name: properties(node) | {"keys": sorted(node.keys())} for node in nodes},
        "active": used.nodes.active.name if used is not None and used.nodes.active else None,
        "values": {
            f"{node.name} {socket.identifier}": properties(socket) for node in nodes for socket in node.inputs
        },
        "links": sorted(
            [link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier,
             link.is_muted, link.is_valid]
            for link in links
        ),
        "view layers": [
            [layer.name, layer.use_pass_z, layer.use, sorted(layer.keys()),
             [[entry.name, entry.exclude] for entry in layer.layer_collection.children]]
            for layer in scene.view_layers
        ],
        "objects": {
            item.name: {name: value for name, value in properties(item).items() if "matrix" not in name}
            | {"keys": sorted(item.keys())}
            for item in scene.objects
        },
        "data": [
            sorted(item.name for item in group if not (group == bpy.data.images and item.type == "COMPOSITING"))
            for group in (
                bpy.data.node_groups, bpy.data.images, bpy.data.objects, bpy.data.meshes, bpy.data.collections,
            )
        ],
        "render": [scene.render.use_compositing, scene.render.compositor_device],
        "scene keys": sorted(key for key in scene.keys() if key not in {"chona", "cycles"}),  # noqa: SIM118
    }  # fmt: skip


def differences(before: object, after: object, path: str = "") -> list[str]:
    """Where two dumps differ."""
    if isinstance(before, dict) and isinstance(after, dict):
        keys = sorted({*before, *after})
        return [words for key in keys for words in differences(before.get(key), after.get(key), f"{path}/{key}")]
    return [] if before == after else [f"{path}: {before!r} became {after!r}"]


def random_tree(scene: bpy.types.Scene, dice: random.Random) -> None:
    """A compositor as a user might have left it; now and then none, or an output without a link."""
    for number in range(dice.randint(0, 2)):
        layer = scene.view_layers.new(f"mine {number}")
        layer.use_pass_z = dice.random() < 0.5
    if dice.random() < 0.1:
        return
    if NEW:
        tree = bpy.data.node_groups.new("mine", "CompositorNodeTree")
        scene.compositing_node_group = tree
        tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        if dice.random() < 0.5:
            tree.interface.new_socket(name="Plate", in_out="INPUT", socket_type="NodeSocketColor")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
    nodes = [tree.nodes.new("CompositorNodeRLayers") for _ in range(dice.randint(0, 3))]
    for node in nodes:
        node.layer = dice.choice(scene.view_layers).name
        node.mute = dice.random() < 0.2
    if NEW and dice.random() < 0.5:
        nodes.append(tree.nodes.new("NodeGroupInput"))
    for kind in dice.choices((*PICTURES, *ENDS), k=dice.randint(0, 8)):
        node = tree.nodes.new(kind)
        if kind == "ShaderNodeMix":
            node.data_type = "RGBA"
        for socket in node.inputs:
            if socket.type == "VALUE" and dice.random() < 0.3:
                socket.default_value = dice.random()
            sources = [entry for other in nodes for entry in other.outputs if entry.enabled and entry.type == "RGBA"]
            if socket.type == "RGBA" and socket.enabled and sources and dice.random() < 0.8:
                tree.links.new(dice.choice(sources), socket).is_muted = dice.random() < 0.2
        nodes.append(node)
    for _ in range(dice.randint(1, 2)):
        output = tree.nodes.new(OUTPUT)
        sources = [entry for node in nodes for entry in node.outputs if entry.enabled and entry.type == "RGBA"]
        if sources and dice.random() < 0.8:
            tree.links.new(dice.choice(sources), output.inputs[0]).is_muted = dice.random() < 0.2
        nodes.append(output)
    frame = tree.nodes.new("NodeFrame")
    for node in nodes:
        node.location = (dice.uniform(-500, 500), dice.uniform(-500, 500))
        node.select = dice.random() < 0.5
        node.parent = frame if dice.random() < 0.3 else None
        node.label = dice.choice(["", "grade", "CHONA"])
        node.mute = node.mute or dice.random() < 0.1
    tree.nodes.active = dice.choice([None, *nodes])


def run(seed: int) -> list[str]:
    """One user's file: up to three layers with random options go in and out in random order."""
    dice = random.Random(seed)
    scene = empty_scene()
    stand_in = bpy.data.objects.new("stand-in", bpy.data.meshes.new("stand-in"))
    stand_in.hide_render = dice.random() < 0.5
    scene.collection.objects.link(stand_in)
    random_tree(scene, dice)
    before = dump(scene)
    figure = Figure(stand_in, stand_ins=(stand_in,))
    names = dice.choices(("walk", "zero", "run"), k=dice.randint(1, 5))
    for name in names:
        options = CompositeOptions(dice.random() < 0.5, dice.random() < 0.5, dice.random() < 0.5, figure)
        compositing.add_layer(scene, frames, name, options)
        wrong = sorted(set(names[: names.index(name) + 1]) - set(compositing.layer_names(scene)))
        if wrong:
            return [f"{wrong} are not in the compositor after {name} was added"]
    left = dice.sample(sorted(set(names)), k=len(set(names)))
    for name in left:
        if not compositing.remove_layer(scene, name):
            return [f"{name} could not be removed"]
    return differences(before, dump(scene))


first, last = int(sys.argv[2]), int(sys.argv[3])
say({"wrong": {seed: found for seed in range(first, last) if (found := run(seed))}})

"""Picks names out of a baked sequence with Blender's own Cryptomatte node; says what it lists and hashes."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
from operation_scene import empty_scene, render, say

folder, first, picks = Path(sys.argv[1]), int(sys.argv[2]), json.loads(sys.argv[3])
scene = empty_scene()
if bpy.app.version >= (5, 0, 0):
    tree = bpy.data.node_groups.new("pick", "CompositorNodeTree")
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    scene.compositing_node_group = tree
    output = tree.nodes.new("NodeGroupOutput")
else:
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("CompositorNodeComposite")
scene.render.compositor_device = "CPU"
image = bpy.data.images.load(str(folder / f"pick_{first:04d}.exr"))
image.source = "SEQUENCE"
node = tree.nodes.new("CompositorNodeCryptomatteV2")
node.source, node.image = "IMAGE", image
answer: dict = {"layer": node.layer_name, "ids": {}}
node.layer_name = "CHONA.CryptoActor"
node.frame_start, node.frame_duration, node.frame_offset = first, 2, first - 1
tree.links.new(node.outputs["Matte"], output.inputs["Image"])
for number, names in enumerate(picks):
    node.matte_id = ",".join(names)
    answer["ids"] |= {entry.name: entry.encoded_hash for entry in node.entries}
    for frame in (first, first + 1):
        render(scene, folder / f"matte_{number}_{frame}.exr", frame)
say(answer)

"""Renders one plate as a CHONA layer and as Blender's own sRGB image. Arguments: plate PNG, frames, output folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from operation_scene import empty_scene, say

from chona_blender import compositing

NEW = bpy.app.version >= (5, 0, 0)
plate, frames, out = (Path(text) for text in sys.argv[1:4])
VIEWS = ("Standard", "AgX", "Filmic")


def blenders_own(scene: bpy.types.Scene) -> None:
    """The plate as an sRGB image straight to the output."""
    if NEW:
        tree = bpy.data.node_groups.new("own", "CompositorNodeTree")
        scene.compositing_node_group = tree
        tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        output = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        output = tree.nodes.new("CompositorNodeComposite")
    node = tree.nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(str(plate))
    tree.links.new(node.outputs["Image"], output.inputs[0])


SPACES = ("Linear Rec.709", "Linear Rec.2020", "ACEScg") if NEW else ("fixed",)
made = []
for space in SPACES:
    for ours in (True, False):
        scene = empty_scene()
        if NEW:
            bpy.ops.wm.set_working_color_space(working_space=space)
            assert bpy.data.colorspace.working_space == space
        if ours:
            compositing.add_layer(scene, frames, "plate")
        else:
            blenders_own(scene)
        scene.render.compositor_device = "CPU"
        scene.render.dither_intensity = 0.0
        if NEW:
            scene.render.image_settings.media_type = "IMAGE"
        scene.render.image_settings.file_format = "PNG"
        scene.render.image_settings.color_mode = "RGB"
        scene.render.image_settings.color_depth = "8"
        scene.frame_set(1)
        for view in VIEWS:
            scene.view_settings.view_transform = view
            name = f"{view} {space} {'ours' if ours else 'own'}.png"
            scene.render.filepath = str(out / name)
            bpy.ops.render.render(write_still=True)
            made.append(name)
say({"made": made})

"""The node group of one baked layer: an image sequence, a depth test and two Alpha Overs.

Blender's Z Combine multiplies premultiplied layers by their alpha a second time, so it is not used. Instead, with
`front` = layer depth < scene depth: `front ? layer over scene : scene over layer`. The second half matters where the
scene is transparent or half transparent in front of the figure; where it is opaque it is the scene itself.
"""

from __future__ import annotations

import bpy

from .frames import BakedFrames

MARK = "chona"
MATTES = ("Human", "Object", "Confidence")


def build_layer_group(name: str) -> bpy.types.NodeTree:
    """A new group: inputs Image and Depth; outputs Image, Depth and the mattes. `set_sequence` gives it its frames."""
    group = bpy.data.node_groups.new(name, "CompositorNodeTree")
    interface = group.interface
    interface.new_socket(name="Image", in_out="INPUT", socket_type="NodeSocketColor")
    interface.new_socket(name="Depth", in_out="INPUT", socket_type="NodeSocketFloat").default_value = 1e10
    interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    interface.new_socket(name="Depth", in_out="OUTPUT", socket_type="NodeSocketFloat")
    for matte in MATTES:
        interface.new_socket(name=matte, in_out="OUTPUT", socket_type="NodeSocketFloat")
    return group


def set_sequence(group: bpy.types.NodeTree, frames: BakedFrames, layer: str) -> None:
    """Fill the group with nodes that show `frames`. Its sockets stay, and with them every link to the group."""
    old = {node.image for node in group.nodes if node.bl_idname == "CompositorNodeImage" and node.image is not None}
    group.nodes.clear()
    image = _sequence_image(group, frames, old)

    inputs = _node(group, "NodeGroupInput", (-700.0, -200.0))
    outputs = _node(group, "NodeGroupOutput", (700.0, 0.0))
    picture = _node(group, "CompositorNodeImage", (-700.0, 200.0))
    picture.image = image
    picture.layer = layer
    first, last = frames.numbers[0], frames.numbers[-1]
    picture.frame_start = first
    picture.frame_offset = first - 1
    # One more than there are: the frame behind the last has no file and stays empty, where Blender would hold the last
    # picture.
    picture.frame_duration = last - first + 2
    picture.use_cyclic = False
    picture.use_auto_refresh = True
    sockets = {socket.name: socket for socket in picture.outputs}

    front = _math(group, "LESS_THAN", sockets["Depth"], inputs.outputs["Depth"], (-350.0, -250.0))
    over = _alpha_over(group, inputs.outputs["Image"], sockets["Combined"], (-350.0, 150.0))
    under = _alpha_over(group, sockets["Combined"], inputs.outputs["Image"], (-350.0, -50.0))
    mix = _node(group, "ShaderNodeMix", (0.0, 100.0))
    mix.data_type = "RGBA"
    named = {socket.identifier: socket for socket in mix.inputs}
    group.links.new(front, named["Factor_Float"])
    group.links.new(under, named["A_Color"])
    group.links.new(over, named["B_Color"])
    group.links.new(next(s for s in mix.outputs if s.identifier == "Result_Color"), outputs.inputs["Image"])

    nearest = _math(group, "MINIMUM", sockets["Depth"], inputs.outputs["Depth"], (0.0, -250.0))
    group.links.new(nearest, outputs.inputs["Depth"])
    for matte in MATTES:
        if matte in sockets:
            group.links.new(sockets[matte], outputs.inputs[matte])


def _sequence_image(group: bpy.types.NodeTree, frames: BakedFrames, old: set[bpy.types.Image]) -> bpy.types.Image:
    """The sequence's image: the one that the group had, or a new one."""
    path = frames.path(frames.numbers[0])
    image = next(iter(old), None)
    if image is None:
        image = bpy.data.images.load(str(path), check_existing=False)
        image.name = group.name
    image.filepath = _stored_path(str(path))
    image.source = "SEQUENCE"
    names = image.colorspace_settings.bl_rna.properties["name"].enum_items.keys()
    if "Linear Rec.709" in names:
        # Never Non-Color: with another working space the colours have to be converted and depth must not be.
        image.colorspace_settings.name = "Linear Rec.709"
    image.reload()
    return image


def _stored_path(path: str) -> str:
    """Relative to the .blend file where the user wants it so and it can be."""
    if not bpy.data.filepath or not bpy.context.preferences.filepaths.use_relative_paths:
        return path
    try:
        return bpy.path.relpath(path)
    except ValueError:  # another drive on Windows
        return path


def _node(group: bpy.types.NodeTree, kind: str, location: tuple[float, float]) -> bpy.types.Node:
    node = group.nodes.new(kind)
    node.location = location
    return node


def _math(
    group: bpy.types.NodeTree,
    operation: str,
    first: bpy.types.NodeSocket,
    second: bpy.types.NodeSocket,
    location: tuple[float, float],
) -> bpy.types.NodeSocket:
    node = _node(group, "ShaderNodeMath", location)
    node.operation = operation
    group.links.new(first, node.inputs[0])
    group.links.new(second, node.inputs[1])
    return node.outputs[0]


def _alpha_over(
    group: bpy.types.NodeTree,
    background: bpy.types.NodeSocket,
    foreground: bpy.types.NodeSocket,
    location: tuple[float, float],
) -> bpy.types.NodeSocket:
    node = _node(group, "CompositorNodeAlphaOver", location)
    colours = [socket for socket in node.inputs if socket.type == "RGBA"]  # names differ between 4.5 and 5
    group.links.new(background, colours[0])
    group.links.new(foreground, colours[1])
    return node.outputs["Image"]

"""A box as the figure's stand-in over a floor beside a mirror, in the sun. Arguments: folder of the frames, output."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy
from mathutils import Vector
from operation_scene import empty_scene, render, say

from chona_blender import compositing
from chona_blender.compositing import CompositeOptions, Figure

NEW = bpy.app.version >= (5, 0, 0)
frames, out = Path(sys.argv[1]), Path(sys.argv[2])


def mesh(name: str, corners: list[tuple[float, float, float]], faces: list[tuple[int, ...]]) -> bpy.types.Object:
    """A mesh object in the scene."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners, [], faces)
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    return item


def shade(item: bpy.types.Object, kind: str, colour: float) -> None:
    """One shader of one grey."""
    material = bpy.data.materials.new(item.name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new(kind), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Color"].default_value = (colour, colour, colour, 1.0)
    shader.inputs["Roughness"].default_value = 0.0
    material.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    item.data.materials.append(material)


def sunny() -> tuple[bpy.types.Scene, bpy.types.Object]:
    """Floor at 0, a box over its middle, a mirror at 45 degrees on the left, sun along (1, 0, -1)."""
    scene = empty_scene()
    scene.cycles.samples = 16
    scene.cycles.diffuse_bounces = 0
    floor = mesh("floor", [(-3, -2, 0), (3, -2, 0), (3, 2, 0), (-3, 2, 0)], [(0, 1, 2, 3)])
    shade(floor, "ShaderNodeBsdfDiffuse", 0.8)
    low, high = Vector((-0.25, -0.25, 1.0)), Vector((0.25, 0.25, 1.5))
    corners = [(x, y, z) for x in (low.x, high.x) for y in (low.y, high.y) for z in (low.z, high.z)]
    box = mesh("box", corners, [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    shade(box, "ShaderNodeBsdfDiffuse", 0.8)
    box.hide_render = True
    mirror = mesh("mirror", [(-1.9, -1, 1.65), (-1.1, -1, 0.85), (-1.1, 1, 0.85), (-1.9, 1, 1.65)], [(0, 1, 2, 3)])
    shade(mirror, "ShaderNodeBsdfGlossy", 1.0)
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = math.pi, 0.0
    sun.rotation_euler = Vector((1, 0, -1)).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(sun)
    return scene, box


def depth_to_output(scene: bpy.types.Scene) -> None:
    """Show the layer's Depth instead of its picture."""
    tree = compositing.current_tree(scene)
    node = next(node for node in tree.nodes if node.bl_idname == "CompositorNodeGroup")
    target = node.outputs["Image"].links[0].to_socket
    tree.links.new(node.outputs["Depth"], target)


answer: dict = {}
for name, options in (
    ("none", {}),
    ("shadows", {"shadows": True}),
    ("both", {"shadows": True, "refined": True}),
    ("taken back", {}),
):
    scene, box = sunny()
    figure = Figure(box, stand_ins=(box,))
    if name == "taken back":
        compositing.add_layer(scene, frames, "empty", CompositeOptions(shadows=True, figure=figure))
    for _ in range(2):  # the second click must find everything as the first one left it
        compositing.add_layer(scene, frames, "empty", CompositeOptions(figure=figure, **options))
    answer[name] = [[item.name, item.hide_render, item.visible_camera] for item in scene.objects if "box" in item.name]
    render(scene, out / f"{name}.exr", 1)
    depth_to_output(scene)
    render(scene, out / f"{name} depth.exr", 1)
say(answer)

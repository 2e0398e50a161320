"""Scenes with known geometry for the compositor tests."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy

WIDTH, HEIGHT = 32, 16
CAMERA_HEIGHT = 10.0


def say(answer: dict) -> None:
    """The script's answer to the test."""
    sys.stdout.write("\n" + json.dumps(answer) + "\n")


def emission_plane(name: str, size: tuple[float, float], location: tuple[float, float, float], colour: tuple) -> None:
    """A flat rectangle that shines in one colour; the camera looks down on it."""
    mesh = bpy.data.meshes.new(name)
    x, y = size[0] / 2, size[1] / 2
    mesh.from_pydata([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], [], [(0, 1, 2, 3)])
    plane = bpy.data.objects.new(name, mesh)
    plane.location = location
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    emission, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Color"].default_value = (*colour, 1.0)
    material.node_tree.links.new(emission.outputs[0], output.inputs["Surface"])
    mesh.materials.append(material)
    bpy.context.scene.collection.objects.link(plane)


def empty_scene() -> bpy.types.Scene:
    """An orthographic camera at z = 10 that looks down on 4 x 2 units; black world, one sample, linear EXR output."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 4.0
    item = bpy.data.objects.new("camera", camera)
    item.location.z = CAMERA_HEIGHT
    scene.collection.objects.link(item)
    scene.camera = item
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.color_mode = "RGBA"
    scene.frame_start, scene.frame_end = 1, 20
    return scene


def render(scene: bpy.types.Scene, path: Path, frame: int) -> None:
    """Render one frame with the compositor to an EXR file."""
    scene.frame_set(frame)
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def describe_tree(tree: bpy.types.NodeTree | None) -> object:
    """Everything about a tree's nodes and links that could be changed by mistake."""
    if tree is None:
        return None
    nodes = [
        [node.name, node.bl_idname, node.label, list(node.location), node.mute, sorted(node.keys())]
        + [repr(socket.default_value) for socket in node.inputs if socket.type == "VALUE"]
        for node in tree.nodes
    ]
    links = [
        [link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier]
        for link in tree.links
    ]
    return {"nodes": sorted(nodes, key=str), "links": sorted(links)}

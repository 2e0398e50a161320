"""The furnished room of the demo's shot, and the lights that capture and shot share."""

from __future__ import annotations

from math import radians

import bpy
import numpy as np
from mathutils import Vector

from demo import atlas
from demo.meshes import material, mesh_object, packed_image

Place = tuple[float, float, float]


STOOL = (0.22, -1.0)
"""Where the stool stands on the floor, metres: between the camera and the figure's legs."""


def aim(item: bpy.types.Object, target: Place) -> None:
    """Turns a camera or light so that it looks at a point."""
    item.rotation_euler = (Vector(target) - item.location).to_track_quat("-Z", "Y").to_euler()


def add_lights(scene: bpy.types.Scene) -> None:
    """A warm key, a cool fill and a pale sky: the same for the capture and for the shot."""
    for name, energy, size, place, colour in (
        ("key", 140.0, 1.6, (2.1, -2.6, 3.2), (1.0, 0.93, 0.84)),
        ("fill", 60.0, 2.5, (-2.8, -1.2, 2.2), (0.82, 0.9, 1.0)),
        ("rim", 70.0, 1.5, (-0.8, 2.6, 2.9), (1.0, 0.97, 0.92)),
    ):
        data = bpy.data.lights.new(name, "AREA")
        data.energy, data.size, data.color = energy, size, colour
        item = bpy.data.objects.new(name, data)
        item.location = place
        aim(item, (0.0, 0.0, 1.0))
        scene.collection.objects.link(item)
    world = bpy.data.worlds.new("sky")
    scene.world = world
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.42, 0.46, 0.52, 1.0)


def add_camera(scene: bpy.types.Scene, name: str, place: Place, target: Place, lens: float) -> bpy.types.Object:
    """A camera that looks at a point; lens in millimetres."""
    data = bpy.data.cameras.new(name)
    data.lens = lens
    item = bpy.data.objects.new(name, data)
    item.location = place
    aim(item, target)
    scene.collection.objects.link(item)
    return item


def set_render(scene: bpy.types.Scene, width: int, height: int, samples: int) -> None:
    """Cycles, denoised, colours as the model learns them."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples = samples
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = 3
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"
    scene.render.compositor_device = "CPU"


def block(
    collection: bpy.types.Collection, name: str, size: Place, place: Place, look: bpy.types.Material, turn: float = 0.0
) -> bpy.types.Object:
    """A box by its sides and middle, turned about the vertical (degrees)."""
    x, y, z = (0.5 * side for side in size)
    corners = np.array([(a * x, b * y, c * z) for c in (-1, 1) for b in (-1, 1) for a in (-1, 1)])
    quads = np.array([(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)])
    item = mesh_object(name, corners, quads, smooth=False)
    item.data.materials.append(look)
    item.location = place
    item.rotation_euler = (0.0, 0.0, radians(turn))
    bevel = item.modifiers.new("Bevel", "BEVEL")
    bevel.width, bevel.segments = min(0.01, 0.2 * min(size)), 2
    collection.objects.link(item)
    return item


def ball(
    collection: bpy.types.Collection, name: str, radii: Place, place: Place, look: bpy.types.Material
) -> bpy.types.Object:
    """An ellipsoid."""
    rings, segments = 16, 24
    tilt, around = np.meshgrid(
        np.linspace(0.02, np.pi - 0.02, rings), np.linspace(0, 2 * np.pi, segments, False), indexing="ij"
    )
    points = np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)], axis=-1)
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(segments), indexing="ij")
    k = (j + 1) % segments
    quads = np.stack([i * segments + j, (i + 1) * segments + j, (i + 1) * segments + k, i * segments + k], axis=-1)
    item = mesh_object(name, points.reshape(-1, 3) * radii, quads.reshape(-1, 4))
    item.data.materials.append(look)
    item.location = place
    collection.objects.link(item)
    return item


def build_room(scene: bpy.types.Scene) -> bpy.types.Collection:
    """Floor, walls, a shelf and a plant behind the figure, a stool with books and a vase in front of it."""
    room = bpy.data.collections.new("room")
    scene.collection.children.link(room)
    wall = material("wall", (0.52, 0.62, 0.60))
    oak, walnut = material("oak", (0.45, 0.26, 0.12)), material("walnut", (0.17, 0.08, 0.04))
    leaf, clay = material("leaf", (0.06, 0.22, 0.07)), material("clay", (0.50, 0.18, 0.09))
    cream, blue = material("cream", (0.75, 0.68, 0.52)), material("blue", (0.08, 0.18, 0.38))
    floor = block(room, "floor", (5.0, 4.6, 0.1), (0.0, 0.0, -0.052), _floor_boards())
    floor.modifiers.clear()
    block(room, "back wall", (5.0, 0.1, 2.8), (0.0, 1.55, 1.4), wall)
    block(room, "skirting", (5.0, 0.03, 0.12), (0.0, 1.485, 0.06), cream)
    for height in (0.45, 0.95, 1.45):
        block(room, "board", (1.1, 0.3, 0.04), (-1.0, 1.28, height), oak)
    for x in (-1.55, -0.45):
        block(room, "side", (0.04, 0.3, 1.5), (x, 1.28, 0.75), oak)
    for number in range(9):
        look = (clay, cream, blue, walnut)[number % 4]
        block(room, "book", (0.05, 0.2, 0.2 + 0.02 * (number % 3)), (-1.42 + 0.062 * number, 1.28, 1.08), look)
    ball(room, "globe", (0.14, 0.14, 0.14), (-0.75, 1.25, 1.62), blue)
    block(room, "frame", (0.7, 0.03, 0.5), (0.75, 1.48, 1.65), walnut)
    block(room, "picture", (0.6, 0.03, 0.4), (0.75, 1.47, 1.65), cream)
    ball(room, "plant pot", (0.19, 0.19, 0.2), (1.15, 0.9, 0.19), clay)
    for number in range(11):
        turn, high = 2.4 * number, 0.55 + 0.06 * number
        place = (1.15 + 0.16 * np.cos(turn), 0.9 + 0.16 * np.sin(turn), high)
        ball(room, "leaf", (0.13, 0.13, 0.09), place, leaf)
    x, y = STOOL
    block(room, "stool seat", (0.42, 0.34, 0.05), (x, y, 0.46), walnut, 15.0)
    for dx, dy in ((-0.16, -0.14), (0.16, -0.06), (-0.18, 0.10), (0.14, 0.16)):
        block(room, "stool leg", (0.04, 0.04, 0.44), (x + dx, y + dy, 0.22), walnut)
    block(room, "book", (0.26, 0.19, 0.05), (x - 0.02, y - 0.01, 0.51), clay, 30.0)
    block(room, "book", (0.24, 0.17, 0.04), (x, y, 0.555), blue, 5.0)
    ball(room, "vase", (0.075, 0.075, 0.13), (x, y, 0.70), cream)
    return room


def _floor_boards() -> bpy.types.Material:
    """Wooden boards as a generated image."""
    size = 512
    row, column = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    board = column // 40
    shift = (atlas.hash_noise(np.stack([board, board, board], axis=-1), 1) * size).astype(int)
    tone = atlas.hash_noise(np.stack([board, (row + shift) // 170, board], axis=-1), 2)
    points = np.stack([column / 9.0, (row + shift) / 120.0, board], axis=-1).astype(float)
    tone = 0.6 * tone + 0.4 * atlas.smooth_noise(points, 1.0, 5)
    colours = np.array([0.34, 0.22, 0.13]) + tone[..., None] * np.array([0.26, 0.19, 0.12])
    colours[(column % 40 < 1) | ((row + shift) % 170 < 1)] *= 0.5
    look = material("floor boards", image=packed_image("floor boards", colours))
    nodes, links = look.node_tree.nodes, look.node_tree.links
    coordinates = nodes.new("ShaderNodeTexCoord")
    texture = next(node for node in nodes if node.type == "TEX_IMAGE")
    links.new(coordinates.outputs["Generated"], texture.inputs["Vector"])
    return look

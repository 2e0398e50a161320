"""Renders figure layers among thin geometry, as Edges: Depth and Edges: Refined. Arguments: JSON of cases, folder.

Each case: bars (name → corners in pixels, depth, colour), a plane behind or none, layers in the order they are added,
the depth of the card, and of a stand-in or none.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
from operation_scene import CAMERA_HEIGHT, emission_plane, empty_scene, render, say

from chona_blender import compositing
from chona_blender.compositing import CompositeOptions, Figure

folder = Path(sys.argv[2])
plan = json.loads(Path(sys.argv[1]).read_text())
width, height = plan["size"]


def quad(name: str, corners: list[list[float]], depth: float, colour: list[float] | None) -> bpy.types.Object:
    """A flat quad whose corners are given in pixels from the picture's upper left."""
    emission_plane(name, (1.0, 1.0), (0.0, 0.0, CAMERA_HEIGHT - depth), tuple(colour or (1.0, 0.0, 1.0)))
    item = bpy.data.objects[name]
    scale = 4.0 / width
    for vertex, (x, y) in zip(item.data.vertices, corners, strict=True):
        vertex.co = ((x - width / 2) * scale, (height / 2 - y) * scale, 0.0)
    return item


for case, given in plan["cases"].items():
    for refined in (False, True):
        scene = empty_scene()
        scene.render.resolution_x, scene.render.resolution_y = width, height
        scene.cycles.samples = plan["samples"]
        scene.cycles.use_adaptive_sampling = False  # counts coverage to a hundredth and stops
        scene.render.film_transparent = given["film"]
        full = [[-1, -1], [width + 1, -1], [width + 1, height + 1], [-1, height + 1]]
        for name, bar in given["bars"].items():
            quad(name, bar["corners"], bar["depth"], bar["colour"])
        if not given["film"]:
            quad("plane", full, 8.0, plan["plane"])
        for layer in given["layers"]:
            place = bpy.data.objects.new(f"place {layer['name']}", None)
            place.location.z = CAMERA_HEIGHT - layer["card"]
            scene.collection.objects.link(place)
            stand_ins = ()
            if layer["stand_in"]:
                stand_in = quad(f"stand-in {layer['name']}", full, layer["stand_in"], None)
                stand_in.hide_render = True
                stand_ins = (stand_in,)
            options = CompositeOptions(refined=refined, figure=Figure(place, stand_ins=stand_ins))
            compositing.add_layer(scene, folder, layer["name"], options)
        render(scene, folder / f"{case} {'refined' if refined else 'depth'}.exr", 1)
say({"version": list(bpy.app.version)})

"""Renders known geometry with baked frames composited. Arguments: folder of the frames, output folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from operation_scene import HEIGHT, WIDTH, emission_plane, empty_scene, render, say

from chona_blender import compositing
from chona_blender.errors import ChonaError

frames, out = Path(sys.argv[1]), Path(sys.argv[2])
answer: dict = {"version": list(bpy.app.version), "errors": {}}

# The scene in four columns: a plane in front (depth 3), one behind (depth 8), nothing, one behind (depth 8).
for film_transparent in (False, True):
    scene = empty_scene()
    scene.render.film_transparent = film_transparent
    emission_plane("front", (1.0, 2.0), (-1.5, 0.0, 7.0), (0.8, 0.1, 0.1))
    emission_plane("behind", (1.0, 2.0), (-0.5, 0.0, 2.0), (0.1, 0.7, 0.1))
    emission_plane("behind too", (1.0, 2.0), (1.5, 0.0, 2.0), (0.1, 0.1, 0.6))
    result = compositing.add_layer(scene, frames, "walk")
    for frame in (3, 4, 6, 7, 8, 9, 12):
        render(scene, out / f"{'film' if film_transparent else 'plain'}_{frame:04d}.exr", frame)
    answer["message"] = result.message
    answer["warnings"] = list(result.warnings)
    answer["device"] = scene.render.compositor_device
    compositing.remove_layer(scene, "walk")
    render(scene, out / f"{'film' if film_transparent else 'plain'}_removed.exr", 7)

scene = empty_scene()
scene.render.resolution_percentage = 50
wrong = (
    ("walk", frames, 50),
    ("other", frames, 100),
    ("walk", frames / "nothing", 100),
    ("old", frames, 100),
    ("flat", frames, 100),
)
for name, folder, percentage in wrong:
    scene.render.resolution_percentage = percentage
    try:
        compositing.add_layer(scene, folder, name)
    except ChonaError as error:
        answer["errors"][f"{name} {percentage} {folder.name}"] = str(error)
answer["size"] = [WIDTH, HEIGHT]

# Two layers, the nearer one added first and added last; then the node of one is deleted by hand, as users do.
for order in (("walk", "near"), ("near", "walk")):
    scene = empty_scene()
    emission_plane("behind", (4.0, 2.0), (0.0, 0.0, 2.0), (0.1, 0.7, 0.1))
    for name in order:
        compositing.add_layer(scene, frames, name)
    render(scene, out / f"{'_'.join(order)}.exr", 7)
tree = compositing.current_tree(scene)
tree.nodes.remove(next(node for node in tree.nodes if node.label == "CHONA near"))
tree.nodes.remove(next(node for node in tree.nodes if node.label == "CHONA walk"))
compositing.add_layer(scene, frames, "walk")
answer["groups after deletion"] = [group.name for group in bpy.data.node_groups if group.users]
tree.nodes.remove(next(node for node in tree.nodes if node.label == "CHONA walk"))
answer["removed after deletion"] = [compositing.remove_layer(scene, "walk"), compositing.has_layers(scene)]

# A whole animation with frame numbers from 0: is each file shown in its own frame?
scene = empty_scene()
scene.frame_start, scene.frame_end = 0, 3
compositing.add_layer(scene, frames, "zero")
scene.render.filepath = str(out / "zero_")
bpy.ops.render.render(animation=True)
say(answer)

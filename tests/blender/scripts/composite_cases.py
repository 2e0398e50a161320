"""Layers in files of several scenes and view layers, libraries, frames that change. Arguments: frames, out folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from mathutils import Euler, Matrix
from operation_scene import CAMERA_HEIGHT, emission_plane, empty_scene, render, say

import chona_blender
from chona_blender import compositing
from chona_blender.compositing import CompositeOptions, Figure
from chona_blender.errors import ChonaError

NEW = bpy.app.version >= (5, 0, 0)
OUTPUT = "NodeGroupOutput" if NEW else "CompositorNodeComposite"
frames, out = Path(sys.argv[1]), Path(sys.argv[2])
answer: dict = {}


def user_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """An empty tree with an output, as a user would have it."""
    if NEW:
        tree = bpy.data.node_groups.new("mine", "CompositorNodeTree")
        scene.compositing_node_group = tree
        tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
    tree.nodes.new(OUTPUT)
    return tree


def output(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """Where the picture ends."""
    return next(node for node in tree.nodes if node.bl_idname == OUTPUT).inputs[0]


def refusal(scene: bpy.types.Scene, *given: object) -> str:
    """Why a layer cannot be put in; empty when it can."""
    try:
        compositing.add_layer(scene, frames, *given)
    except ChonaError as error:
        return str(error)
    return ""


# View layers: the picture comes from `second` and `third`; one shows the plane in front, one that behind.
scene = empty_scene()
for name, depth, x in (("near", 3.0, -1.0), ("far", 8.0, 0.0)):
    emission_plane(name, (2.0 if name == "near" else 4.0, 2.0), (x, 0.0, CAMERA_HEIGHT - depth), (0.5, 0.5, 0.5))
    collection = bpy.data.collections.new(name)
    scene.collection.children.link(collection)
    collection.objects.link(bpy.data.objects[name])
    scene.collection.objects.unlink(bpy.data.objects[name])
scene.render.film_transparent = True
tree = user_tree(scene)
over = tree.nodes.new("CompositorNodeAlphaOver")
colours = [socket for socket in over.inputs if socket.type == "RGBA"]
for name, excluded, socket in (("second", "near", colours[0]), ("third", "far", colours[1])):
    layer = scene.view_layers.new(name)
    layer.layer_collection.children[excluded].exclude = True
    node = tree.nodes.new("CompositorNodeRLayers")
    node.layer = name
    tree.links.new(node.outputs["Image"], socket)
tree.links.new(over.outputs["Image"], output(tree))
compositing.add_layer(scene, frames, "walk")
answer["z passes"] = [[layer.name, layer.use_pass_z] for layer in scene.view_layers]
render(scene, out / "layers.exr", 4)

# The user puts a grade behind the layer; a second bake has to go before it, and both can go in any order.
tree = compositing.current_tree(scene)
walk = next(node for node in tree.nodes if node.label == "CHONA walk")
grade = tree.nodes.new("CompositorNodeExposure")
tree.links.new(walk.outputs["Image"], grade.inputs["Image"])
tree.links.new(grade.outputs["Image"], output(tree))
compositing.add_layer(scene, frames, "near")
near = next(node for node in tree.nodes if node.label == "CHONA near")
answer["before the grade"] = [
    grade.inputs["Image"].links[0].from_node == near,
    output(tree).links[0].from_node == grade,
]
compositing.remove_layer(scene, "walk")
answer["walk gone"] = [
    grade.inputs["Image"].links[0].from_node == near,
    near.inputs["Image"].links[0].from_node == over,
]
compositing.remove_layer(scene, "near")
answer["both gone"] = [grade.inputs["Image"].links[0].from_node == over, len(tree.nodes)]

# A border that does not crop: the layer is seen inside it, and nothing is where nothing was rendered.
scene = empty_scene()
emission_plane("behind", (4.0, 2.0), (0.0, 0.0, 2.0), (0.5, 0.5, 0.5))
compositing.add_layer(scene, frames, "walk")
scene.render.use_border = True
scene.render.border_min_x, scene.render.border_max_x = 0.25, 0.5
scene.render.border_min_y, scene.render.border_max_y = 0.0, 1.0
answer["size warned"] = compositing.size_words(scene, "walk")
render(scene, out / "border.exr", 4)
scene.render.use_border = False
scene.render.resolution_percentage = 50
answer["size words"] = compositing.size_words(scene, "walk")
answer["options refused"] = [
    refusal(scene, "walk", CompositeOptions(refined=True)),
    refusal(scene, "walk", CompositeOptions(shadows=True)),
]
scene.render.resolution_percentage = 100
place = bpy.data.objects.new("place", None)
for number in (1, 2):
    camera = bpy.data.objects.new(f"shot {number}", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.timeline_markers.new(f"cut {number}", frame=number).camera = camera
answer["options refused"] += [
    refusal(scene, "walk", CompositeOptions(refined=True)),
    refusal(scene, "walk", CompositeOptions(shadows=True)),
    refusal(scene, "walk", CompositeOptions(refined=True, figure=Figure(place))),
]
answer["view layers after refusal"] = len(scene.view_layers)

# Passes: only sockets whose passes the frames have; what the second bake lacks goes with a warning.
scene = empty_scene()
result = compositing.add_layer(scene, frames, "rich")
outputs = [item.name for item in result.group.interface.items_tree if item.in_out == "OUTPUT"]
tree = compositing.current_tree(scene)
node = next(node for node in tree.nodes if node.label == "CHONA rich")
mattes = [node for node in tree.nodes if node.bl_idname == "CompositorNodeCryptomatteV2"]
answer["rich"] = [outputs, len(mattes), [matte.matte_id for matte in mattes]]
emission_plane("wall", (2.0, 2.0), (-1.0, 0.0, 7.0), (0.5, 0.5, 0.5))
compositing.add_layer(scene, frames, "rich", CompositeOptions())
for name, socket in (("human", node.outputs["Human"]), ("normal", node.outputs["Normal"]),
                     ("alpha", node.outputs["Alpha"]), ("matte", mattes[0].outputs["Matte"])):  # fmt: skip
    tree.links.new(socket, output(tree))
    render(scene, out / f"pass_{name}.exr", 4)
(frames / "rich_0004.exr").write_bytes((frames / "bare_0004.exr").read_bytes())
result = compositing.add_layer(scene, frames, "rich")
answer["bare"] = [
    [item.name for item in result.group.interface.items_tree if item.in_out == "OUTPUT"],
    list(result.warnings),
    sum(node.bl_idname == "CompositorNodeCryptomatteV2" for node in tree.nodes),
]

# A layer that an earlier version made, with fewer sockets, is updated by the second click.
scene = empty_scene()
emission_plane("behind", (4.0, 2.0), (0.0, 0.0, 2.0), (0.5, 0.5, 0.5))
group = compositing.add_layer(scene, frames, "walk").group
for item in list(group.interface.items_tree):
    if item.name not in {"Image", "Depth"}:
        group.interface.remove(item)
compositing.add_layer(scene, frames, "walk")
render(scene, out / "older.exr", 4)

# The card keeps a bone's distance from a camera that looks askew, in every frame.
scene = empty_scene()
scene.camera.matrix_world = Matrix.Translation((3.0, -4.0, 2.0)) @ Euler((1.2, 0.1, 0.7)).to_matrix().to_4x4()
scene.camera.data.type = "PERSP"
armature = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
scene.collection.objects.link(armature)
bpy.context.view_layer.objects.active = armature
bpy.ops.object.mode_set(mode="EDIT")
bone = armature.data.edit_bones.new("hips")
bone.head, bone.tail = (0.0, 0.0, 0.9), (0.0, 0.0, 1.1)
bpy.ops.object.mode_set(mode="OBJECT")
for frame, x in ((1, 0.0), (9, 2.0)):
    armature.pose.bones["hips"].location.x = x
    armature.pose.bones["hips"].keyframe_insert("location", frame=frame)
compositing.add_layer(scene, frames, "walk", CompositeOptions(refined=True, figure=Figure(armature, "hips")))
card = bpy.data.objects["CHONA walk front card"]
card.hide_viewport = False  # it is shown to renders alone, and evaluated for these
bpy.context.window.view_layer = scene.view_layers["CHONA walk front"]
answer["card"] = []
for frame in (1, 5, 9):
    scene.frame_set(frame)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    seen = scene.camera.matrix_world.inverted() @ card.evaluated_get(depsgraph).matrix_world
    rig = armature.evaluated_get(depsgraph)
    hips = scene.camera.matrix_world.inverted() @ rig.matrix_world @ rig.pose.bones["hips"].head
    answer["card"].append([list(seen.translation), hips.z, list(seen.to_euler())])
answer["card in"] = [[layer.name, card.name in layer.objects] for layer in scene.view_layers]

# Two stand-ins of an actor: the setting in their panel says what they are, and both are given back as they were.
scene = empty_scene()
chona_blender.register()
actor = scene.chona.actors.add()
parts = [bpy.data.objects.new(name, bpy.data.meshes.new(name)) for name in ("person", "crate")]
for part in parts:
    scene.collection.objects.link(part)
    entry = actor.stand_in.parts.add()
    entry.name, entry.object = part.name, part
parts[1].visible_glossy = False
actor.stand_in.use = "HOLDOUT"
figure = Figure(parts[0], stand_ins=tuple(parts))
uses = []
for use in (True, False):
    compositing.add_layer(scene, frames, "walk", CompositeOptions(shadows=use, figure=figure))
    flags = [[part.hide_render, part.visible_camera, part.is_holdout, part.visible_glossy] for part in parts]
    uses.append([actor.stand_in.use, flags])
answer["stand-ins"] = uses
chona_blender.unregister()

# Two scenes; in 5.x they share a tree.
scene = empty_scene()
other = bpy.data.scenes.new("other")
other.render.resolution_x, other.render.resolution_y = scene.render.resolution_x, scene.render.resolution_y
other.camera = scene.camera
user_tree(scene)
if NEW:
    other.compositing_node_group = scene.compositing_node_group
else:
    user_tree(other)
for each in (scene, other):
    compositing.add_layer(each, frames, "walk")
answer["two scenes"] = [compositing.layer_names(scene), compositing.layer_names(other)]
answer["removed"] = [compositing.remove_layer(scene, "walk"), compositing.remove_layer(other, "walk")]
answer["states"] = [compositing.has_layers(scene), compositing.has_layers(other)]
answer["groups"] = [group.name for group in bpy.data.node_groups if group.name.startswith("CHONA")]

# Libraries.
bpy.ops.wm.save_as_mainfile(filepath=str(out / "library.blend"))
scene = empty_scene()
with bpy.data.libraries.load(str(out / "library.blend"), link=True) as (there, here):
    here.scenes = ["other"]
    if NEW:
        here.node_groups = ["mine"]
linked = next(item for item in bpy.data.scenes if item.library is not None)
answer["linked scene"] = refusal(linked, "walk")
if NEW:
    scene.compositing_node_group = bpy.data.node_groups["mine"]
    answer["linked tree"] = refusal(scene, "walk")
    answer["state after refusal"] = compositing.has_layers(scene)
say(answer)

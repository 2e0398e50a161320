"""Stand-ins in Blender's data: mesh objects in a collection of their own, with colours, materials and modifiers."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.types import Collection, Material, Mesh, Object, Scene

from .standin_bind import Binding
from .standin_file import PartMesh

COLLECTION = "CHONA Stand-Ins"
KEY = "chona_stand_in"
"""Custom property of objects, materials and collections that this module made; on objects the identity's name."""

COLOUR = "Color"
MODIFIER = "CHONA Armature"
ROUGHNESS = 0.85


def collection_of(scene: Scene) -> Collection:
    """The scene's collection of stand-ins, made where there is none."""
    for each in scene.collection.children_recursive:
        if KEY in each:
            return each
    made = bpy.data.collections.new(COLLECTION)
    made[KEY] = True
    made.color_tag = "COLOR_05"
    scene.collection.children.link(made)
    return made


def new_object(scene: Scene, name: str, identity: str) -> Object:
    """An empty mesh object that a click in the viewport does not select: bones behind it stay within reach."""
    item = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    item[KEY] = identity
    item.hide_select = True
    collection_of(scene).objects.link(item)
    return item


def fill(item: Object, part: PartMesh, vertices: np.ndarray) -> None:
    """Gives an object's mesh its vertices [V, 3], faces and colours; materials and all settings stay."""
    mesh: Mesh = item.data
    mesh.clear_geometry()
    count, triangles = len(vertices), len(part.faces)
    mesh.vertices.add(count)
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, dtype=np.float32).ravel())
    mesh.loops.add(3 * triangles)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(part.faces, dtype=np.int32).ravel())
    mesh.polygons.add(triangles)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * triangles, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
    attribute = mesh.color_attributes.new(COLOUR, "BYTE_COLOR", "POINT")
    colours = np.ones((count, 4), dtype=np.float32)
    colours[:, :3] = part.colours / np.float32(255.0)
    attribute.data.foreach_set("color_srgb", colours.ravel())
    mesh.color_attributes.active_color = attribute
    mesh.color_attributes.render_color_index = mesh.color_attributes.active_color_index
    if not mesh.materials:
        mesh.materials.append(new_material(item.name, part.colours))


def new_material(name: str, colours: np.ndarray) -> Material:
    """A rough surface of the vertices' colours; in the viewport's Material colours it has their mean."""
    material = bpy.data.materials.new(name)
    material[KEY] = True
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    attribute, surface, output = (
        tree.nodes.new(kind) for kind in ("ShaderNodeAttribute", "ShaderNodeBsdfPrincipled", "ShaderNodeOutputMaterial")
    )
    attribute.attribute_name = COLOUR
    attribute.location, surface.location, output.location = (-520.0, 0.0), (-280.0, 0.0), (20.0, 0.0)
    surface.inputs["Roughness"].default_value = ROUGHNESS
    tree.links.new(attribute.outputs["Color"], surface.inputs["Base Color"])
    tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    encoded = colours.reshape(-1, 3).mean(axis=0) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    material.diffuse_color = (*linear, 1.0)
    material.roughness = ROUGHNESS
    return material


def new_armature(name: str) -> Object:
    """An armature without bones that nobody sees, in no collection yet."""
    item = bpy.data.objects.new(name, bpy.data.armatures.new(name))
    item[KEY] = name
    item.hide_select = item.hide_viewport = item.hide_render = True
    return item


def attach_to_armature(item: Object, armature: Object, binding: Binding, figure: Object | None = None) -> None:
    """Weights and the modifier; the object stands in the armature's space.

    Args:
        figure: in the armature's space too, deforms the mesh instead of it.
    """
    item.vertex_groups.clear()
    for bone, (indices, weights) in binding.groups.items():
        group = item.vertex_groups.new(name=bone)
        for weight in np.unique(weights):
            group.add(indices[weights == weight].tolist(), float(weight), "REPLACE")
    modifier = item.modifiers.get(MODIFIER)
    if modifier is None:
        modifier = item.modifiers.new(MODIFIER, "ARMATURE")
    modifier.object = armature if figure is None else figure
    modifier.use_vertex_groups, modifier.use_bone_envelopes = True, False
    _hang(item, armature, 1.0)


def attach_to_object(item: Object, mover: Object, scale: float) -> None:
    """The mesh of an object under what moves it.

    Args:
        scale: metres of the world in a metre of the model.
    """
    own = float(np.cbrt(abs(np.linalg.det(np.array(mover.matrix_world, dtype=np.float64)[:3, :3]))))
    _hang(item, mover, scale / own if own > 0.0 else 1.0)


def _hang(item: Object, parent: Object, scale: float) -> None:
    item.parent, item.parent_type = parent, "OBJECT"
    item.matrix_parent_inverse.identity()
    item.matrix_basis.identity()
    item.rotation_mode = "XYZ"
    item.location, item.rotation_euler, item.scale = (0.0,) * 3, (0.0,) * 3, (scale,) * 3


def remove_objects(items: list[Object]) -> None:
    """Removes objects with their meshes, and whatever else this module made that nothing uses any more."""
    contents = {item.data for item in items}
    meshes = [data for data in contents if isinstance(data, Mesh)]
    materials = {slot for mesh in meshes for slot in mesh.materials if slot is not None and KEY in slot}
    for item in items:
        bpy.data.objects.remove(item)
    for data in contents:
        if data.users == 0:
            (bpy.data.meshes if isinstance(data, Mesh) else bpy.data.armatures).remove(data)
    for material in materials:
        if material.users == 0:
            bpy.data.materials.remove(material)
    for collection in [each for each in bpy.data.collections if KEY in each]:
        if not collection.objects and not collection.children:
            bpy.data.collections.remove(collection)

"""Robin in Blender: an armature with SMPL's bones and one skinned, painted mesh."""

from __future__ import annotations

import bpy
import numpy as np

from demo import atlas
from demo.body import BONES, PARENTS, PERSON, bone_tails, build_body, rest_joints
from demo.meshes import material, mesh_object, packed_image
from demo.paint import paint_body

RIG_NAME = f"{PERSON}.original"
MESH_NAME = f"{PERSON}.mesh"


def build_armature(collection: bpy.types.Collection) -> bpy.types.Object:
    """The armature in T-pose at the origin, facing −y."""
    armature = bpy.data.armatures.new(RIG_NAME)
    rig = bpy.data.objects.new(RIG_NAME, armature)
    collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for name, parent, head, tail in zip(BONES, PARENTS, rest_joints(), bone_tails(), strict=True):
        bone = armature.edit_bones.new(name)
        bone.head, bone.tail = head, tail
        if parent >= 0:
            bone.parent = armature.edit_bones[BONES[parent]]
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in rig.pose.bones:
        bone.rotation_mode = "QUATERNION"
    return rig


def build_character(collection: bpy.types.Collection, step: float = 0.01) -> tuple[bpy.types.Object, bpy.types.Object]:
    """Armature and mesh, linked into the collection.

    Args:
        step: size of the mesh's quads, metres.
    """
    rig = build_armature(collection)
    body = build_body(step)
    uvs = atlas.corner_uvs(len(body.quads))
    mesh = mesh_object(MESH_NAME, body.vertices, body.quads, uvs)
    collection.objects.link(mesh)
    texels = atlas.texel_points(body.vertices, body.quads)
    flat = texels.reshape(-1, 3)
    colours = paint_body(flat, body.part_of(flat)).reshape(texels.shape)
    mesh.data.materials.append(material(MESH_NAME, image=packed_image(MESH_NAME, atlas.pack(colours))))
    for index, name in enumerate(BONES):
        group = mesh.vertex_groups.new(name=name)
        _assign(group, body.weights[:, index])
    mesh.parent = rig
    modifier = mesh.modifiers.new("Armature", "ARMATURE")
    modifier.object = rig
    return rig, mesh


def _assign(group: bpy.types.VertexGroup, weights: np.ndarray) -> None:
    """Weights above zero into a vertex group."""
    for vertex in np.flatnonzero(weights).tolist():
        group.add([vertex], float(weights[vertex]), "REPLACE")

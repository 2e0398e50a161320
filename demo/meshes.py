"""Meshes, images and materials in Blender from numpy arrays."""

from __future__ import annotations

import bpy
import numpy as np


def mesh_object(
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray | None = None,
    smooth: bool = True,
) -> bpy.types.Object:
    """An unlinked object with a mesh of equal polygons.

    Args:
        vertices: [V, 3] metres.
        faces: [F, K] vertex indices, counter-clockwise from outside.
        uvs: [F, K, 2] texture coordinates of the faces' corners.
    """
    mesh = bpy.data.meshes.new(name)
    count, corners = faces.shape
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, dtype=np.float32).ravel())
    mesh.loops.add(count * corners)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, dtype=np.int32).ravel())
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, count * corners, corners, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.validate()
    mesh.polygons.foreach_set("use_smooth", np.full(count, smooth))
    if uvs is not None:
        layer = mesh.uv_layers.new(name="UVMap")
        layer.data.foreach_set("uv", np.ascontiguousarray(uvs, dtype=np.float32).ravel())
    return bpy.data.objects.new(name, mesh)


def packed_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """An sRGB image [H, W, 3] (first row at the bottom) kept inside the .blend file."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False)
    rgba = np.ones((height, width, 4), dtype=np.float32)
    rgba[..., :3] = pixels
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    return image


def material(
    name: str,
    colour: tuple[float, float, float] = (0.8, 0.8, 0.8),
    image: bpy.types.Image | None = None,
    roughness: float = 0.8,
    specular: float = 0.15,
) -> bpy.types.Material:
    """A mostly diffuse material: the model learns colours that do not change with the view.

    Args:
        colour: scene-linear; an image takes its place.
    """
    result = bpy.data.materials.new(name)
    result.use_nodes = True
    nodes, links = result.node_tree.nodes, result.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Specular IOR Level"].default_value = specular
    if image is not None:
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = image
        links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return result

"""The crate: painted planks, a stencilled star and iron corners."""

from __future__ import annotations

import bpy
import numpy as np

from demo import atlas
from demo.meshes import material, mesh_object, packed_image
from demo.poses import CRATE_HALF

OBJECT = "crate"
CELLS = 14
"""Quads along each edge of a face: the grain of the painted texture."""

WOOD_DARK, WOOD_LIGHT = np.array([0.42, 0.26, 0.12]), np.array([0.72, 0.50, 0.27])
IRON, RED, CREAM = np.array([0.16, 0.17, 0.19]), np.array([0.74, 0.13, 0.10]), np.array([0.93, 0.88, 0.74])
PLANKS = 4


def build_crate(collection: bpy.types.Collection) -> tuple[bpy.types.Object, bpy.types.Object]:
    """An empty that carries the crate, and the mesh on it."""
    vertices, quads, faces = _box(CRATE_HALF)
    mesh = mesh_object(f"{OBJECT}.mesh", vertices, quads, atlas.corner_uvs(len(quads)), smooth=False)
    texels = atlas.texel_points(vertices, quads)
    colours = _paint(texels.reshape(-1, 3), np.repeat(faces, atlas.TILE**2)).reshape(texels.shape)
    mesh.data.materials.append(material(OBJECT, image=packed_image(OBJECT, atlas.pack(colours))))
    carrier = bpy.data.objects.new(f"{OBJECT}.carrier", None)
    carrier.rotation_mode = "QUATERNION"
    mesh.parent = carrier
    for item in (carrier, mesh):
        collection.objects.link(item)
    return carrier, mesh


def _box(half: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices [V, 3], quads [F, 4] and each quad's face (0…5: −x, +x, −y, +y, −z, +z)."""
    vertices, quads, faces = [], [], []
    share = np.linspace(-1.0, 1.0, CELLS + 1)
    for axis in range(3):
        for sign in (-1.0, 1.0):
            first = sum(len(part) for part in vertices)
            u, v = (axis + 1) % 3, (axis + 2) % 3
            points = np.zeros((CELLS + 1, CELLS + 1, 3))
            points[..., axis] = sign * half[axis]
            points[..., u] = share[:, None] * half[u]
            points[..., v] = share[None, :] * half[v]
            vertices.append(points.reshape(-1, 3))
            i, j = np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij")
            corner = first + i * (CELLS + 1) + j
            ring = np.stack([corner, corner + CELLS + 1, corner + CELLS + 2, corner + 1], axis=-1).reshape(-1, 4)
            quads.append(ring if sign > 0 else ring[:, ::-1])
            faces.append(np.full(len(ring), 2 * axis + (sign > 0)))
    return np.concatenate(vertices), np.concatenate(quads), np.concatenate(faces)


def _paint(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """sRGB colours [K, 3] of points on the crate."""
    axis = faces // 2
    rows = np.arange(len(points))
    u, v = (np.where(axis == 0, 1, 0), np.where(axis == 2, 1, 2))
    along, across = points[rows, u] / CRATE_HALF[u], points[rows, v] / CRATE_HALF[v]
    plank = np.floor((across + 1.0) * 0.5 * PLANKS)
    grain = atlas.smooth_noise(points, (0.08, 0.08, 0.008), 3) * 0.6 + atlas.smooth_noise(points, 0.012, 4) * 0.4
    tone = 0.25 * atlas.hash_noise(np.stack([plank, faces, faces], axis=-1), 9) + 0.75 * grain
    colour = WOOD_DARK + tone[:, None] * (WOOD_LIGHT - WOOD_DARK)
    seam = np.abs((across + 1.0) * 0.5 * PLANKS - np.round((across + 1.0) * 0.5 * PLANKS)) < 0.06
    colour = np.where((seam & (np.abs(across) < 0.97))[:, None], WOOD_DARK * 0.45, colour)
    radius, angle = np.hypot(along * 1.25, across), np.arctan2(across, along * 1.25)
    star = radius < 0.55 * (0.62 + 0.38 * np.cos(5.0 * (angle - np.pi / 2)))
    disc = radius < 0.72
    painted = np.where(np.isin(faces, (2, 5))[:, None], CREAM, RED)
    colour = np.where((disc & ~star & (axis != 0))[:, None], 0.85 * painted + 0.15 * colour, colour)
    stripe = (np.abs(along) < 0.16) & (axis == 0)
    colour = np.where(stripe[:, None], 0.8 * CREAM + 0.2 * colour, colour)
    corner = (np.abs(along) > 0.80) & (np.abs(across) > 0.74)
    nail = np.hypot(np.abs(along) - 0.90, np.abs(across) - 0.87) < 0.035
    colour = np.where(corner[:, None], IRON, colour)
    return np.where(nail[:, None], IRON * 3.2, colour)

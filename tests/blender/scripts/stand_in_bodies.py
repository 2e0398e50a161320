"""Model files of headers alone and stand-ins of known shapes, for the stand-in's tests."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import bpy
import numpy as np
from rig_bodies import SMPL, SMPL_PARENTS, smpl_joints

from chona_blender import actions, standin
from chona_blender.rig.cast import cast
from chona_blender.standin_file import PartMesh, read_stand_in

JOINTS = smpl_joints()
LOWER, UPPER = (-0.2, -0.1, -0.15), (0.2, 0.1, 0.15)
OCTAHEDRON = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
CORNERS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)


def write_model(path: Path) -> Path:
    """A model of one person with SMPL's bones and one crate; its tensors are not there."""
    description = {
        "format": "chona-model", "version": 1, "method": "chona", "field": "grid",
        "skeleton": {"names": SMPL, "parents": SMPL_PARENTS}, "persons": {"Robin": {"rest_joints": JOINTS.tolist()}},
        "objects": {"crate": {"lower": LOWER, "upper": UPPER}}, "object_distance": 1.5, "settings": {}, "training": {},
    }  # fmt: skip
    header = json.dumps({"__metadata__": {"chona": json.dumps(description)}}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header)
    return path


def body(seed: int = 0) -> dict[str, np.ndarray]:
    """Octahedra along all bones: [V, 3] vertices up to 7 cm from the bones, weights that fall off over 3 cm."""
    random = np.random.default_rng(seed)
    tails = np.array(JOINTS)
    for index, parent in enumerate(SMPL_PARENTS):
        if index in SMPL_PARENTS:
            tails[index] = JOINTS[[child for child, up in enumerate(SMPL_PARENTS) if up == index]].mean(axis=0)
        elif parent >= 0:
            tails[index] = JOINTS[index] + 0.5 * (JOINTS[index] - JOINTS[parent])
    along = tails - JOINTS
    centres = (JOINTS[:, None] + np.linspace(0.1, 0.9, 5)[:, None] * along[:, None]).reshape(-1, 3)
    vertices = (centres[:, None] + random.uniform(0.03, 0.07, (len(centres), 1, 1)) * CORNERS).reshape(-1, 3)
    share = np.einsum("vbi,bi->vb", vertices[:, None] - JOINTS, along) / (along**2).sum(axis=1)
    nearest = JOINTS + np.clip(share, 0.0, 1.0)[..., None] * along
    close = np.exp(-np.linalg.norm(vertices[:, None] - nearest, axis=2) / 0.03)
    bones = np.argsort(-close, axis=1)[:, :4]
    weights = np.take_along_axis(close, bones, axis=1)
    weights /= weights.sum(axis=1, keepdims=True)
    kept = weights >= 0.01
    weights = np.where(kept, weights, 0.0)
    faces = (OCTAHEDRON + 6 * np.arange(len(centres))[:, None, None]).reshape(-1, 3)
    colours = np.broadcast_to(random.integers(0, 256, 3), vertices.shape)
    return {
        "vertices": vertices.astype(np.float32), "faces": faces.astype(np.int32),
        "colours": colours.astype(np.uint8), "bones": np.where(kept, bones, -1).astype(np.int16),
        "weights": (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
    }  # fmt: skip


def crate() -> dict[str, np.ndarray]:
    """A box of the object's size in its own frame, blue."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [(a, b, c) for a, b, c, _ in sides] + [(a, c, d) for a, _, c, d in sides]
    return {
        "vertices": np.where(corners, UPPER, LOWER).astype(np.float32), "faces": np.array(faces, dtype=np.int32),
        "colours": np.broadcast_to(np.array([20, 40, 200], dtype=np.uint8), (8, 3)),
    }  # fmt: skip


def write_stand_in(path: Path, content: dict[str, dict[str, np.ndarray]], **changes: object) -> Path:
    """A file as the worker writes it: parts by name, those with bones are persons."""
    header = {
        "format": "chona-stand-in", "version": 1, "model": "", "voxel": 0.01, "opacity": 0.5,
        "skeleton": {"names": SMPL, "parents": SMPL_PARENTS}, "rest_joints": JOINTS.tolist(),
        "parts": [
            {"kind": "person" if "bones" in part else "object", "name": name, "vertices": len(part["vertices"]),
             "faces": len(part["faces"])}
            for name, part in content.items()
        ],
    }  # fmt: skip
    arrays = {"header": np.frombuffer(json.dumps(header | changes).encode(), dtype=np.uint8)}
    for index, part in enumerate(content.values()):
        arrays |= {f"part.{index}.{name}": array for name, array in part.items()}
    np.savez(path, **arrays)
    return path


def put_together(scene: bpy.types.Scene, file: Path) -> list[bpy.types.Object]:
    """Builds the selected actor's stand-in from a file, as the operator does when its worker has ended."""
    actor = scene.chona.actor
    found = cast(actions.actor_plan(actor))
    return standin.build(scene, actor, found, read_stand_in(file, len(SMPL)))


def evaluated(item: bpy.types.Object) -> np.ndarray:
    """[V, 3] vertices in the world after all modifiers."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    own = item.evaluated_get(depsgraph)
    mesh = own.to_mesh()
    places = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", places)
    own.to_mesh_clear()
    world = np.array(own.matrix_world)
    return places.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]


def skinned(world_from_bone: np.ndarray, part: PartMesh) -> np.ndarray:
    """Forward skinning by its definition, vertex by vertex: Σ w T x with T = world_from_bone · translation(−joint)."""
    transforms = np.array(world_from_bone, dtype=float)
    for index, joint in enumerate(JOINTS):
        shift = np.eye(4)
        shift[:3, 3] = -joint
        transforms[index] = transforms[index] @ shift
    places = np.concatenate([part.vertices, np.ones((len(part.vertices), 1))], axis=1)
    found = np.zeros((len(places), 3))
    for row, (place, bones, weights) in enumerate(zip(places, part.bones, part.weights, strict=True)):
        for bone, weight in zip(bones, weights, strict=True):
            if bone >= 0:
                found[row] += weight * (transforms[bone] @ place)[:3]
    return found

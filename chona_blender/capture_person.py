"""The captured person's surface in canonical space with its skinning weights, and an object's extent."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from bpy.types import Mesh, Object, Scene

from .errors import ChonaError
from .rig.rest_pose import RestPose
from .rig.sampling import evaluation_scene
from .shot_file import write_npz


def skeleton_of(armature: Object) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """The deform bones of an armature as a skeleton: names, and parents before their children.

    A bone's parent is its nearest deforming ancestor; further roots hang on the first one.

    Raises:
        ChonaError: no bone deforms.
    """
    names: list[str] = []
    parents: list[int] = []
    pending = [bone for bone in armature.data.bones if bone.parent is None][::-1]
    while pending:
        bone = pending.pop()
        pending.extend(reversed(bone.children))
        if bone.use_deform:
            ancestor = bone.parent
            while ancestor is not None and not ancestor.use_deform:
                ancestor = ancestor.parent
            names.append(bone.name)
            parents.append(names.index(ancestor.name) if ancestor else min(len(names) - 2, 0))
    if not names:
        raise ChonaError(f"Armature '{armature.name}' has no deforming bone. Switch Deform on for the bones to capture")
    return tuple(names), tuple(parents)


def bone_owners(armature: Object, bones: Sequence[str]) -> dict[str, int]:
    """Which of the skeleton's ``bones`` each of the armature's bones belongs to: itself, else its nearest ancestor."""
    index = {name: position for position, name in reversed(list(enumerate(bones)))}
    owners = {}
    for bone in armature.data.bones:
        ancestor = bone
        while ancestor is not None and ancestor.name not in index:
            ancestor = ancestor.parent
        owners[bone.name] = index[ancestor.name] if ancestor else 0
    return owners


def _coordinates(mesh: Mesh) -> np.ndarray:
    flat = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3).astype(np.float64)


def _triangles(mesh: Mesh) -> np.ndarray:
    mesh.calc_loop_triangles()
    flat = np.empty(len(mesh.loop_triangles) * 3, dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", flat)
    return flat.reshape(-1, 3).astype(np.int64)


def _group_weights(mesh: Mesh, groups: dict[int, int], bones: int) -> np.ndarray:
    weights = np.zeros((len(mesh.vertices), bones))
    for index, vertex in enumerate(mesh.vertices):
        for element in vertex.groups:
            if element.group in groups:
                weights[index, groups[element.group]] += element.weight
    return weights


def write_person(
    path: Path, scene: Scene, armature: Object, meshes: Sequence[Object], *, rest: RestPose, frame: int
) -> None:
    """Writes ``persons/<name>.npz``: vertices [V, 3] and weights [V, B] in canonical space, faces [T, 3].

    Modifiers count (mirror, subdivision); the armature is put in its rest position while the meshes are read and back
    afterwards.  Vertices in no bone's group follow the bone the mesh is parented to, else the nearest joint.

    Args:
        rest: of the skeleton's bones, in its order.
        frame: scene frame at which the meshes are read.

    Raises:
        ChonaError: there are no vertices, or the file cannot be written.
    """
    owners = bone_owners(armature, rest.bones)
    vertices, weights, faces = [], [], []
    before = armature.data.pose_position
    armature.data.pose_position = "REST"
    try:
        with evaluation_scene(scene, [armature, *meshes]) as temporary:
            temporary.frame_set(frame)
            depsgraph = temporary.view_layers[0].depsgraph
            armature_from_world = np.linalg.inv(np.array(armature.evaluated_get(depsgraph).matrix_world))
            for each in meshes:
                evaluated = each.evaluated_get(depsgraph)
                mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
                if mesh is None:
                    continue
                move = armature_from_world @ np.array(evaluated.matrix_world, dtype=np.float64)
                points = _coordinates(mesh) @ move[:3, :3].T + move[:3, 3]
                groups = {group.index: owners[group.name] for group in each.vertex_groups if group.name in owners}
                shares = _group_weights(mesh, groups, len(rest.bones))
                shares[shares.sum(axis=1) < 1e-6] = 0.0
                _fill_unweighted(shares, points, each, armature=armature, owners=owners, rest=rest)
                faces.append(_triangles(mesh) + sum(len(block) for block in vertices))
                vertices.append(points @ rest.rotation / rest.scale)
                weights.append(shares / shares.sum(axis=1, keepdims=True))
                evaluated.to_mesh_clear()
    finally:
        armature.data.pose_position = before
    if not sum(len(block) for block in vertices):
        raise ChonaError("The character has no mesh with vertices. Choose the meshes that the armature deforms")
    write_npz(
        path,
        {"vertices": np.concatenate(vertices), "weights": np.concatenate(weights), "faces": np.concatenate(faces)},
    )


def _fill_unweighted(
    shares: np.ndarray, points: np.ndarray, item: Object, *, armature: Object, owners: dict[str, int], rest: RestPose
) -> None:
    """Gives rows of ``shares`` [V, B] that are zero a weight of 1 on one bone, in place."""
    empty = np.flatnonzero(shares.sum(axis=1) == 0.0)
    if not empty.size:
        return
    if item.parent == armature and item.parent_type == "BONE" and item.parent_bone in owners:
        shares[empty, owners[item.parent_bone]] = 1.0
        return
    for chunk in np.array_split(empty, len(empty) // 4096 + 1):
        distance = np.linalg.norm(points[chunk, None] - rest.heads[None], axis=-1)
        shares[chunk, distance.argmin(axis=1)] = 1.0


def object_extent(
    scene: Scene, meshes: Sequence[Object], world_from_object: np.ndarray, frame: int
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (lower [3], upper [3]) of an object's meshes in its rigid frame, metres.

    Args:
        world_from_object: [4, 4] rigid, at ``frame``.

    Raises:
        ChonaError: there are no vertices.
    """
    points = []
    object_from_world = np.linalg.inv(world_from_object)
    with evaluation_scene(scene, meshes) as temporary:
        temporary.frame_set(frame)
        depsgraph = temporary.view_layers[0].depsgraph
        for each in meshes:
            evaluated = each.evaluated_get(depsgraph)
            mesh = evaluated.to_mesh()
            if mesh is not None and len(mesh.vertices):
                move = object_from_world @ np.array(evaluated.matrix_world, dtype=np.float64)
                points.append(_coordinates(mesh) @ move[:3, :3].T + move[:3, 3])
            evaluated.to_mesh_clear()
    if not points:
        raise ChonaError("The captured object has no mesh with vertices. Choose the meshes that belong to it")
    stacked = np.concatenate(points)
    return stacked.min(axis=0), stacked.max(axis=0)

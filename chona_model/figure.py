"""Poses as the model sees them: relative to the root bone, so that where a figure stands in the world never matters.

*Root space* is the posed world moved rigidly so that the root bone's canonical-to-posed transform is the identity: the
figure stays about where its canonical body is, whether it stands at the origin or 10 km away.  The move happens in
float64 on the host; only then do numbers become float32.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from chona_model.camera import Camera
from chona_model.skeleton import Skeleton, canonical_to_world, translation

OBJECT_CLEARANCE = 0.5
"""Between the root joint and the nearest an object can come to it in canonical space, turned anyhow, metres."""

OBJECT_GAP = 0.2
"""Between the spheres around objects of neighbouring slots in canonical space, metres."""


FARTHEST = 1e6
"""Entries of matrices relative to the root, metres where they are lengths: beyond, float32 keeps no centimetre, and
products of two leave its range sooner or later."""


class PoseError(ValueError):
    """A pose that cannot be rendered: broken bones or objects, or more of them than the model has room for."""


def object_places(object_distance: float, slots: int) -> np.ndarray:
    """[N, 3] where the objects of each slot stand in canonical space relative to the root joint, metres.

    The first stands in front of the body, the others beside it, left and right in turn; none can touch another or the
    body, turned anyhow, because the greatest object fits a sphere of radius ``object_distance − OBJECT_CLEARANCE``.
    """
    spacing = 2.0 * max(object_distance - OBJECT_CLEARANCE, 0.0) + OBJECT_GAP
    aside = [(slot + 1) // 2 * (1 if slot % 2 else -1) for slot in range(slots)]
    return np.array([[place * spacing, 0.0, object_distance] for place in aside]).reshape(slots, 3)


@dataclass(frozen=True)
class Rig:
    """What is posed: a skeleton, the rest joints of one person and where objects stand.

    Attributes:
        skeleton: B body bones.
        rest_joints: [B, 3] canonical joints of this person, metres.
        object_distance: how far in front of the root joint (+z) objects are placed in canonical space, metres; see
            ``object_places``.
        turns_objects: whether objects turn; else they only move, and keep the world's axes.
        reach: metres beyond a body's own reach in which a person may hold what has no bone.
    """

    skeleton: Skeleton
    rest_joints: np.ndarray
    object_distance: float
    turns_objects: bool = True
    reach: float = 0.0

    def canonical_objects(self, slots: int) -> np.ndarray:
        """[N, 3] canonical position of the object frame of each slot."""
        return self.rest_joints[0] + object_places(self.object_distance, slots)


@dataclass(frozen=True)
class Figure:
    """One pose of a person and its objects in root space.

    Attributes:
        transforms: [J, 4, 4] canonical to root space (the paper's T_j), J = B body bones then N objects; float64.
        root_from_world: [4, 4] the rigid move into root space, float64.
        present: [J] bool; False for body bones of an absent person and for empty object slots.
    """

    transforms: np.ndarray
    root_from_world: np.ndarray
    present: np.ndarray

    def rays(self, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions [..., 3] in root space of rays through pixels [..., 2]; float64.

        Directions have unit length along the camera axis, so that ray parameters are depths.
        """
        origins, directions = camera.rays(pixels)
        rotation, offset = self.root_from_world[:3, :3], self.root_from_world[:3, 3]
        # The camera may be as far from the origin as the figure: subtract before rotating, both in float64.
        centre = -rotation.T @ offset
        return (origins - centre) @ rotation.T, directions @ rotation.T

    def turn_to_world(self, directions: np.ndarray) -> np.ndarray:
        """Directions [..., 3] of root space in the world; float32."""
        return np.asarray(directions @ self.root_from_world[:3, :3], dtype=np.float32)


def make_figure(
    rig: Rig, world_from_bone: np.ndarray | None, world_from_object: np.ndarray, object_slots: int
) -> Figure:
    """Moves a pose into root space.

    The root is the first body bone, or the first object where there is no person.

    Args:
        world_from_bone: [B, 4, 4] rigid frames, or None for objects alone.
        world_from_object: [N, 4, 4] rigid frames, N ≤ ``object_slots``.
        object_slots: how many object bones the model has; missing ones are marked absent.

    Raises:
        PoseError: neither person nor object, more objects than slots, or a matrix that is not finite or far beyond
            anything that could be seen; the bone or object is named.
    """
    bones = len(rig.skeleton)
    objects = len(world_from_object)
    if world_from_bone is None and objects == 0:
        raise PoseError("a figure needs a person or an object, got neither")
    if objects > object_slots:
        raise PoseError(f"the pose has {objects} objects, the model has room for {object_slots}")
    names = [f"bone '{name}'" for name in rig.skeleton.names] + [f"object {slot + 1}" for slot in range(object_slots)]
    if world_from_bone is not None:
        _refuse_unless(_finite(world_from_bone), names, "has a matrix that is not finite")
    _refuse_unless(_finite(world_from_object), names[bones:], "has a matrix that is not finite")
    transforms = np.broadcast_to(np.eye(4), (bones + object_slots, 4, 4)).copy()
    present = np.zeros(bones + object_slots, dtype=bool)
    if world_from_bone is not None:
        transforms[:bones] = canonical_to_world(world_from_bone, rig.rest_joints)
        present[:bones] = True
    if objects and not rig.turns_objects:
        world_from_object = translation(world_from_object[:, :3, 3])
    if objects:
        transforms[bones : bones + objects] = world_from_object @ translation(-rig.canonical_objects(objects))
        present[bones : bones + objects] = True
    root = transforms[0 if world_from_bone is not None else bones]
    root_from_world = np.eye(4)
    root_from_world[:3, :3] = root[:3, :3].T
    root_from_world[:3, 3] = -root[:3, :3].T @ root[:3, 3]
    relative = np.broadcast_to(np.eye(4), transforms.shape).copy()
    # R_rootᵀ (t_j − t_root): the difference is taken before the rotation so that far away nothing cancels.
    relative[:, :3, :3] = root[:3, :3].T @ transforms[:, :3, :3]
    relative[:, :3, 3] = (transforms[:, :3, 3] - root[:3, 3]) @ root[:3, :3]
    relative[~present] = np.eye(4)
    _refuse_unless(
        np.abs(relative).max(axis=(1, 2)) <= FARTHEST,
        names,
        f"has a matrix with values beyond {FARTHEST:g} (metres) relative to the root",
    )
    return Figure(relative, root_from_world, present)


def _finite(matrices: np.ndarray) -> np.ndarray:
    """[K] bool of matrices [K, 4, 4]."""
    return np.array([bool(np.isfinite(matrix).all()) for matrix in matrices], dtype=bool)


def _refuse_unless(fine: np.ndarray, names: Sequence[str], complaint: str) -> None:
    """Raises a ``PoseError`` about the first of ``names`` that is not ``fine``."""
    if not fine.all():
        name = names[int(np.argmin(fine))]
        raise PoseError(f"the pose's {name} {complaint}; expected a rigid matrix, check its animation")


def pose_code_size(bones: int, object_slots: int) -> int:
    """Length of the vectors that ``pose_codes`` returns."""
    return 6 * bones + 9 * object_slots


def pose_codes(figures: Sequence[Figure], rig: Rig) -> np.ndarray:
    """What offset and shading are conditioned on: [P, 6 B + 9 N] float64.

    Each body bone gives the first two columns of its rotation relative to its parent (continuous everywhere, unlike
    axis-angle near π), each object those of its rotation relative to the root and its position relative to the root
    joint, in metres.  Absent bones give zeros.
    """
    rows = []
    for figure in figures:
        rotation = figure.transforms[:, :3, :3]
        bones = len(rig.skeleton)
        parents = np.array(rig.skeleton.parents)
        parent_rotation = rotation[np.maximum(parents, 0)]
        local = (
            np.where((parents >= 0)[:, None, None], np.swapaxes(parent_rotation, -1, -2), np.eye(3)) @ rotation[:bones]
        )
        body = np.where(figure.present[:bones, None, None], local[..., :2], 0.0).reshape(-1)
        objects = []
        places = rig.canonical_objects(len(rotation) - bones)
        for index in range(bones, len(rotation)):
            posed = figure.transforms[index, :3, :3] @ places[index - bones] + figure.transforms[index, :3, 3]
            code = np.concatenate([rotation[index, :, :2].reshape(-1), posed - rig.rest_joints[0]])
            objects.append(code if figure.present[index] else np.zeros(9))
        rows.append(np.concatenate([body, *objects]))
    return np.stack(rows)


@dataclass(frozen=True)
class RayBatch:
    """Rays in root space, each of one of P poses.

    Attributes:
        origins, directions: [R, 3]; directions have unit length along the camera axis.
        radii: [R] cone radius at unit depth (mip-NeRF's base radius: pixel width · 2/√12 / focal), or of the whole
            cylinder for orthographic cameras.
        near, far: [R] depths between which to sample; ``far <= near`` marks a ray that misses the figure.
        pose: [R] int64 index of the ray's pose.
    """

    origins: Tensor
    directions: Tensor
    radii: Tensor
    near: Tensor
    far: Tensor
    pose: Tensor


@dataclass(frozen=True)
class RayResult:
    """What rendering a batch of rays gives, colours premultiplied and sRGB encoded.

    Attributes:
        rgb: [R, 3]; alpha: [R]; depth: [R] alpha-weighted mean depth over alpha (1e10 where alpha is 0).
        mattes: [R, 1 + N] share of the alpha that belongs to body bones and to the object of each slot.
        confidence: [R] share of the samples (by weight where alpha > 0, else by count) whose root converged.
        failed_share: scalar in 0…1, samples without any converged root.
        regularisers: named training terms (``weights``, ``offset``), scalars; empty when rendering.
        normal: [R, 3] mean of unit normals in root space, weighted as colours are; None where not asked for.
    """

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    mattes: Tensor
    confidence: Tensor
    failed_share: Tensor
    regularisers: dict[str, Tensor]
    normal: Tensor | None = None

    @property
    def human(self) -> Tensor:
        """[R] share of the alpha that belongs to body bones."""
        return self.mattes[:, 0]

    @property
    def object(self) -> Tensor:
        """[R] share of the alpha that belongs to objects."""
        return self.mattes[:, 1:].sum(dim=-1)


@dataclass(frozen=True)
class PoseBatch:
    """P poses as tensors, of the dtype and on the device they are to be computed with.

    Attributes:
        transforms: [P, J, 4, 4] canonical to root space.
        present: [P, J] bool.
        codes: [P, C] from ``pose_codes``.
        tails: [P, B, 3] and heads [P, B, 3]: canonical bone segments (they differ between persons).
        persons: [P] int64 index of the identity, objects: [P, N] int64; −1 where absent.
    """

    transforms: Tensor
    present: Tensor
    codes: Tensor
    heads: Tensor
    tails: Tensor
    persons: Tensor
    objects: Tensor


def to_pose_batch(
    figures: Sequence[Figure],
    rigs: Sequence[Rig],
    persons: Sequence[int],
    objects: Sequence[Sequence[int]],
    dtype: torch.dtype = torch.float32,
    device: str | torch.device = "cpu",
) -> PoseBatch:
    """Stacks figures (each with its rig and identity indices) into tensors."""
    codes = np.concatenate([pose_codes([figure], rig) for figure, rig in zip(figures, rigs, strict=True)])
    heads = np.stack([rig.rest_joints for rig in rigs])
    tails = np.stack([rig.skeleton.bone_tails(rig.rest_joints) for rig in rigs])

    def real(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, dtype=dtype, device=device)

    return PoseBatch(
        transforms=real(np.stack([figure.transforms for figure in figures])),
        present=torch.as_tensor(np.stack([figure.present for figure in figures]), device=device),
        codes=real(codes),
        heads=real(heads),
        tails=real(tails),
        persons=torch.as_tensor(persons, dtype=torch.int64, device=device),
        objects=torch.as_tensor(objects, dtype=torch.int64, device=device).reshape(len(figures), -1),
    )

"""Body models of the SMPL family: shaped template, rest joints, posed bone frames, and SMPL-H's reduction to 24 bones.

SMPL-H has 52 joints: 22 of the body, then 15 finger joints a hand; SMPL has the same 22 and one ``hand`` a side.  The
reduction puts the hand bone at the middle finger's first joint (SMPL's own hand joint lies at the knuckles), turns it
as that joint turns against the wrist, and gives it the weights of all fingers of its side.  With fingers at rest every
finger moves rigidly with the wrist, so 24 bones move the vertices exactly as 52 do; other finger poses are reduced to
the middle finger's first joint.

Pose-dependent corrective shapes (``posedirs``) are left out: they move vertices, not bones.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from chona_model.data.dataset import DatasetError
from chona_model.data.reading import real_numbers
from chona_model.data.restricted_pickle import MODEL_BYTES, read_pickle
from chona_model.plain_arrays import ArraysError, read_arrays
from chona_model.skeleton import SMPL, SMPL_NAMES, SMPL_PARENTS, Skeleton, canonical_to_world, forward_kinematics

FARTHEST = 1e3
"""Metres from the origin, or per unit of a beta, of a body's vertices."""

_FINGERS = ("index", "middle", "pinky", "ring", "thumb")


def _smplh() -> Skeleton:
    names, parents = list(SMPL_NAMES[:22]), list(SMPL_PARENTS[:22])
    for side, wrist in (("left", 20), ("right", 21)):
        for finger in _FINGERS:
            for joint in (1, 2, 3):
                parents.append(wrist if joint == 1 else len(names) - 1)
                names.append(f"{side}_{finger}{joint}")
    return Skeleton(tuple(names), tuple(parents))


SMPLH = _smplh()
_KEPT = (*range(22), SMPLH.names.index("left_middle1"), SMPLH.names.index("right_middle1"))
"""SMPL-H joint of each of the 24 bones."""


@dataclass(frozen=True)
class BodyModel:
    """A linear blend-skinned body of variable shape.

    Attributes:
        skeleton: B bones.
        vertices: [V, 3] mean shape in T-pose, y up, metres.
        faces: [T, 3].
        weights: [V, B] rows sum to one.
        shape_directions: [V, 3, S] metres per unit of beta.
        joints: [B, 3] rest joints of the mean shape.
        joint_directions: [B, 3, S] metres per unit of beta.
    """

    skeleton: Skeleton
    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    shape_directions: np.ndarray
    joints: np.ndarray
    joint_directions: np.ndarray

    def shaped(self, betas: np.ndarray) -> np.ndarray:
        """[V, 3] the T-pose surface of a body with these betas; missing betas are zero, surplus ones ignored."""
        return self.vertices + _along(self.shape_directions, betas)

    def rest_joints(self, betas: np.ndarray) -> np.ndarray:
        """[B, 3] joints of the T-pose of a body with these betas, metres."""
        return self.joints + _along(self.joint_directions, betas)

    def world_from_bone(self, pose: np.ndarray, betas: np.ndarray, trans: np.ndarray) -> np.ndarray:
        """Posed bone frames.

        Args:
            pose: [B, 3] or [B * 3] axis-angle rotations relative to the parent, radians.
            betas: [S] shape.
            trans: [3] added after posing (the root turns about its rest joint), metres.

        Returns:
            [B, 4, 4] rigid, float64.
        """
        rotations = Rotation.from_rotvec(np.asarray(pose, dtype=np.float64).reshape(-1, 3)).as_matrix()
        return forward_kinematics(self.skeleton, self.rest_joints(betas), rotations, np.asarray(trans, np.float64))

    def posed(self, pose: np.ndarray, betas: np.ndarray, trans: np.ndarray) -> np.ndarray:
        """[V, 3] linear blend skinning of the shaped template, metres."""
        frames = self.world_from_bone(pose, betas, trans)
        return skin(self.shaped(betas), self.weights, canonical_to_world(frames, self.rest_joints(betas)))

    def reduced(self) -> BodyModel:
        """This model on SMPL's 24 bones (itself if it already has them)."""
        if len(self.skeleton) == len(SMPL):
            return self
        weights = np.concatenate(
            [self.weights[:, :22], self.weights[:, 22:37].sum(1)[:, None], self.weights[:, 37:].sum(1)[:, None]], axis=1
        )
        kept = list(_KEPT)
        return BodyModel(
            SMPL, self.vertices, self.faces, weights, self.shape_directions, self.joints[kept],
            self.joint_directions[kept],
        )  # fmt: skip


def reduced_pose(pose: np.ndarray) -> np.ndarray:
    """[24, 3] axis-angle rotations of SMPL's bones from SMPL-H's ([156]), SMPL's ([72]) or the body's alone ([66])."""
    numbers = np.asarray(pose, dtype=np.float64).reshape(-1)
    pose = numbers[: len(numbers) // 3 * 3].reshape(-1, 3)
    if len(numbers) % 3:
        pose = pose[:0]
    if len(pose) == len(SMPLH):
        return pose[list(_KEPT)]
    if len(pose) == 22:
        return np.concatenate([pose, np.zeros((2, 3))])
    if len(pose) == len(SMPL):
        return pose
    raise DatasetError(f"a body pose has {numbers.size} numbers, expected 156 (SMPL-H), 72 (SMPL) or 66 (body alone)")


def skin(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """[V, 3] linear blend skinning of ``vertices`` [V, 3] by ``weights`` [V, B] and ``transforms`` [B, 4, 4]."""
    blended = np.einsum("vb,bij->vij", weights, transforms)
    return np.einsum("vij,vj->vi", blended[:, :3, :3], vertices) + blended[:, :3, 3]


def read_body_model(path: Path) -> BodyModel:
    """Reads an SMPL (24 joints) or SMPL-H (52 joints) file, ``.npz`` or ``.pkl``.

    Raises:
        DatasetError: the file is missing, damaged, holds Python objects, or is no such model.
    """
    needed = ("v_template", "f", "J_regressor", "weights", "kintree_table", "shapedirs")
    content: Mapping[str, Any] = _read_npz(path, needed) if path.suffix == ".npz" else read_pickle(path, MODEL_BYTES)
    missing = [name for name in needed if not isinstance(content, dict) or name not in content]
    if missing:
        raise DatasetError(f"{path} lacks {', '.join(missing)}; expected an SMPL or SMPL-H model file")
    vertices, regressor, weights, directions = (
        _numbers(content, name, dimensions, path)
        for name, dimensions in (("v_template", 2), ("J_regressor", 2), ("weights", 2), ("shapedirs", 3))
    )
    count, bones = len(vertices), weights.shape[-1]
    skeleton = {len(SMPL): SMPL, len(SMPLH): SMPLH}.get(bones)
    if skeleton is None:
        raise DatasetError(f"{path} has {bones} joints, expected 24 (SMPL) or 52 (SMPL-H)")
    parents, faces = (_numbers(content, name, 2, path) for name in ("kintree_table", "f"))
    shapes = {
        "v_template": (vertices.shape, (count, 3)),
        "weights": (weights.shape, (count, bones)),
        "J_regressor": (regressor.shape, (bones, count)),
        "shapedirs": (directions.shape[:2], (count, 3)),
        "kintree_table": (parents.shape, (2, bones)),
        "f": (faces.shape, (len(faces), 3)),
    }
    for name, (found, expected) in shapes.items():
        if found != expected:
            raise DatasetError(f"{path}: {name} has the shape {found}, expected {expected}; the file is damaged")
    if parents[0, 1:].tolist() != list(skeleton.parents[1:]):
        raise DatasetError(
            f"{path} has its {bones} joints in another order than SMPL's files; convert it to that order"
        )
    if ((faces < 0) | (faces >= count)).any() or not (weights.sum(1) > 0).all():
        raise DatasetError(f"{path} has triangles of vertices, or vertices of bones, that are not there; copy it again")
    faces = faces.astype(np.int64)
    return BodyModel(
        skeleton, vertices, faces, weights / weights.sum(1, keepdims=True), directions, regressor @ vertices,
        np.einsum("bv,vis->bis", regressor, directions),
    )  # fmt: skip


def body_model_folders(explicit: Path | None, usual: Sequence[Path]) -> list[Path]:
    """Where body models are looked for: the folder that the user names, else $CHONA_BODY_MODELS and the usual ones."""
    if explicit is not None:
        return [explicit]
    variable = os.environ.get("CHONA_BODY_MODELS")
    return [*([Path(variable)] if variable else []), *usual]


def find_body_model(folders: list[Path], gender: str) -> Path:
    """The SMPL-H (else SMPL) file of a gender in the first folder that has one.

    Known names are those of the publishers' archives: ``SMPLH_male.npz``, ``SMPLH_MALE.pkl``, ``male/model.npz``,
    ``SMPL_MALE.pkl``, ``basicmodel_m_lbs_10_207_0_v1.0.0.pkl``, in any case.

    Raises:
        DatasetError: none of them has one; the message says where a folder can be named.
    """
    short = {"male": "m", "female": "f"}.get(gender, gender)
    stems = (f"smplh_{gender}", f"{gender}/model", f"smplh/{gender}/model", f"smpl_{gender}", f"basicmodel_{short}")
    for folder in folders:
        files = sorted(path for path in folder.rglob("*") if path.suffix in (".npz", ".pkl")) if folder.is_dir() else []
        for stem in stems:
            for path in files:
                if path.relative_to(folder).as_posix().lower().startswith(stem):
                    return path
    raise DatasetError(
        f"no SMPL-H file for the gender '{gender}' (such as SMPLH_{gender}.npz) in "
        f"{', '.join(str(folder) for folder in folders)}; download the model from https://mano.is.tue.mpg.de and "
        "name its folder with --body-model DIR or $CHONA_BODY_MODELS, or put it into a folder 'smplh' beside the data"
    )


def _along(directions: np.ndarray, betas: np.ndarray) -> np.ndarray:
    betas = np.asarray(betas, dtype=np.float64).reshape(-1)[: directions.shape[-1]]
    return directions[..., : len(betas)] @ betas


def _numbers(content: Mapping[str, Any], name: str, dimensions: int, path: Path) -> np.ndarray:
    """An array of a body model as float64, sizes of its parts and limits of its numbers checked."""
    try:
        array = real_numbers(content[name])
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{path}: {name} holds something else than numbers ({error})") from error
    if array.ndim != dimensions or array.size == 0:
        raise DatasetError(
            f"{path}: {name} has the shape {array.shape}, expected {dimensions} dimensions; the file is damaged"
        )
    if not np.isfinite(array).all() or (name in ("v_template", "shapedirs") and np.abs(array).max() > FARTHEST):
        raise DatasetError(f"{path} holds values that are not finite, or no body's, in {name}; the file is damaged")
    return array


def _read_npz(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    try:
        return read_arrays(path, names)
    except (OSError, ArraysError) as error:
        raise DatasetError(
            f"cannot read the body model {path}: {error}; expected a complete .npz of plain arrays ({', '.join(names)})"
        ) from error

"""The masks' visual hull: which cells of every part could hold anything, from all poses and views at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from chona_model.data.dataset import View
from chona_model.data.images import Pixels
from chona_model.deform.voxels import distance_to_bones
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.kernels.cpu.march import carve
from chona_model.render.occupancy import UNKNOWN_DENSITY
from chona_model.render.posed import camera_matrix

MASK_MARGIN = 2
"""Masks are widened by this many pixels before carving: they are thresholded, and skinning is not yet learned."""

INSIDE_SHARE = 0.95
"""A cell stays when it falls inside the widened masks in this share of the views that see it."""

OWN_SHARE = 0.05
"""… and inside its own part's mask in this share: a cell that is always seen as the object is not the person's."""

HELD_SHARE = 0.5
"""The same where what is held belongs to the person: it is not where the body says in every frame."""

BODY_REACH = 0.10
"""Cells farther from the body model's surface than this are empty (clothes, hair and shoes fit), metres."""

BONE_REACH = 0.20
"""The same without a body model, from the bones, metres."""


def carve_hull(
    model: GridModel, poses: Sequence[PosedFigure], views: Sequence[Sequence[tuple[View, Pixels]]],
    parts: Sequence[int],
) -> None:  # fmt: skip
    """Sets the model's occupancy to the visual hull.

    Args:
        poses: every training pose; views: the images of each.
        parts: which to carve; the others stay as they are.
    """
    occupancy = model.occupancy
    union = [[binary_dilation(pixels.mask, iterations=MASK_MARGIN) for _, pixels in row] for row in views]
    for part in parts:
        cells = np.arange(len(occupancy.part(part)))
        is_person = part < len(model.persons)
        if is_person:
            cells = cells[_near_body(model, part, occupancy.centres(part, cells))]
        share = HELD_SHARE if is_person and model.shape.reach > 0.0 else INSIDE_SHARE
        centres = occupancy.centres(part, cells)
        inside, own, seen = (np.zeros(len(cells), dtype=np.int32) for _ in range(3))
        for pose, row, masks in zip(poses, views, union, strict=True):
            posed = _posed_centres(model, part, pose, centres)
            if posed is None:
                continue
            for (view, pixels), mask in zip(row, masks, strict=True):
                matrix = camera_matrix(pose.figure, view.camera)
                intrinsics = view.camera.intrinsics
                carve(posed, matrix, intrinsics, mask, inside, seen)
                carve(
                    posed, matrix, intrinsics, pixels.person if is_person else pixels.object, own, np.zeros_like(seen)
                )
        kept = (seen > 0) & (inside >= share * seen) & (own >= OWN_SHARE * seen)
        occupancy.part(part)[:] = 0.0
        occupancy.part(part)[cells[kept]] = UNKNOWN_DENSITY
        whole = slice(occupancy.first[part], occupancy.first[part + 1])
        occupancy.support[whole] = occupancy.densities[whole] > 0


def _near_body(model: GridModel, person: int, centres: np.ndarray) -> np.ndarray:
    surface, joints = model.persons[person].surface, model.persons[person].rest_joints
    if surface is not None:
        reach = BODY_REACH + model.shape.reach
        return cKDTree(surface.vertices).query(centres, distance_upper_bound=reach)[0] < reach
    tails = model.skeleton.bone_tails(joints)
    near = [distance_to_bones(chunk, joints, tails).min(axis=1) for chunk in np.array_split(centres, 64)]
    return np.concatenate(near) < BONE_REACH + model.shape.reach


def _posed_centres(model: GridModel, part: int, pose: PosedFigure, centres: np.ndarray) -> np.ndarray | None:
    if part < len(model.persons):
        return model.warp_points(pose, centres) if pose.person == part else None
    thing = part - len(model.persons)
    if thing not in pose.objects:
        return None
    matrix = pose.slots[pose.objects.index(thing)].astype(np.float64)
    return (centres - matrix[:, 3]) @ matrix[:, :3]

"""Signed distances in place of free densities: the surface that ARAH learns, with a smooth prior to begin from.

The field's raw output r stands for the distance s = ``SOFTNESS`` · (1 − r), so the density 100 · softplus(r − 1) is
that of s: large inside, falling over ``SOFTNESS`` outside.  Two things make it a distance: it begins as the distance to
a smooth body, and the eikonal loss holds the length of its gradient at 1 (Gropp et al. 2020), by differences over
``SPACING`` as Neuralangelo takes them, so that only first derivatives of the field are needed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from chona_model.data.dataset import ObjectShape, Person, SkinnedSurface
from chona_model.deform.voxels import distance_to_bones
from chona_model.grid_model import GridModel
from chona_model.skeleton import Skeleton
from chona_model.train.grid_optimiser import GridOptimiser

SOFTNESS = 0.005
"""Metres over which the density falls at the surface."""

SPACING = 0.008
"""Metres on either side over which the gradient's length is taken."""

NEAR = 0.03
"""Beyond this many metres from the surface the prior is flat, and the eikonal loss is not asked for."""

PRIOR_STEPS, PRIOR_POINTS = 150, 8192
EIKONAL_POINTS, EIKONAL_WEIGHT = 384, 0.1
CAPSULE = 0.07
"""Radius of the prior's body around bones without a body model, metres."""
OBJECT_SHARE = 0.8
"""Size of an object's ellipsoid beside its box."""
NEIGHBOURS = 6

UsualPair = Callable[[int], Tensor]
"""[1, 2] the identities that a part is trained with."""


class DistanceField:
    """The prior and the eikonal loss of a model's density.

    Args:
        model: whose field it is; pair: of every part; seed: of everything random, together with the step.
    """

    def __init__(self, model: GridModel, pair: UsualPair, seed: int) -> None:
        self.model, self.pair, self.seed = model, pair, seed

    def begin(self, optimiser: GridOptimiser) -> None:
        """Fits the field to the prior; ``optimiser`` is used up."""
        for index in range(PRIOR_STEPS):
            random = np.random.default_rng([self.seed, index, 3])
            loss = self.model.real(np.zeros(()))
            for part in range(len(self.model.occupancy.dims)):
                points = self._points(part, PRIOR_POINTS // len(self.model.occupancy.dims), random)
                wanted = np.clip(self._prior(part, points), -NEAR, NEAR)
                loss = loss + ((self._distance(part, points) - self.model.real(wanted)) ** 2).mean()
            optimiser.clear()
            (loss / NEAR**2).backward()
            optimiser.step(index, index / PRIOR_STEPS)

    def eikonal(self, step: int) -> Tensor:
        """The weighted mean of (|∇s| − 1)² around one part's surface."""
        random = np.random.default_rng([self.seed, step, 2])
        part = int(random.integers(len(self.model.occupancy.dims)))
        points = self._points(part, EIKONAL_POINTS, random)
        shifts = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32) * SPACING
        around = (points[None] + shifts[:, None]).reshape(-1, 3)
        distance = self._distance(part, around).reshape(6, len(points))
        gradient = (distance[:3] - distance[3:]) / (2.0 * SPACING)
        length = torch.sqrt((gradient**2).sum(dim=0) + 1e-12)
        near = (distance.detach().abs().amin(dim=0) < NEAR).to(length.dtype)
        return EIKONAL_WEIGHT * (near * (length - 1.0) ** 2).sum() / near.sum().clamp(min=1.0)

    def _points(self, part: int, count: int, random: np.random.Generator) -> np.ndarray:
        """[count, 3] float32 in and around occupied cells of a part, in its own frame."""
        occupancy = self.model.occupancy
        cells = random.choice(
            np.flatnonzero(occupancy.support[occupancy.first[part] : occupancy.first[part + 1]]), count
        )
        points = occupancy.centres(part, cells) + random.normal(scale=2.0 * occupancy.cell, size=(count, 3))
        return points.astype(np.float32)

    def _distance(self, part: int, points: np.ndarray) -> Tensor:
        model = self.model
        rows = torch.full((len(points),), part, dtype=torch.int32, device=model.device)
        pair = torch.zeros(len(points), dtype=torch.int64, device=model.device)
        raw = model.field.raw_density(model.real(points), rows, self.pair(part).to(model.device), pair)
        return SOFTNESS * (1.0 - raw)

    def _prior(self, part: int, points: np.ndarray) -> np.ndarray:
        persons = self.model.persons
        if part >= len(persons):
            return ellipsoid_distance(self.model.objects[part - len(persons)], points)
        return body_distance(persons[part], self.model.skeleton, points)


def body_distance(person: Person, skeleton: Skeleton, points: np.ndarray) -> np.ndarray:
    """[K] signed distance of canonical points [K, 3] to a person's body model, or to capsules around its bones."""
    if person.surface is None:
        tails = skeleton.bone_tails(person.rest_joints)
        return distance_to_bones(points, person.rest_joints, tails).min(axis=1) - CAPSULE
    surface = person.surface
    distance, nearest = cKDTree(surface.vertices).query(points, k=NEIGHBOURS)
    along = np.einsum("kni,kni->kn", points[:, None] - surface.vertices[nearest], vertex_normals(surface)[nearest])
    return np.where(along.mean(axis=1) < 0.0, -1.0, 1.0) * distance[:, 0]


def vertex_normals(surface: SkinnedSurface) -> np.ndarray:
    """[V, 3] outward unit normals, faces weighted by their area."""
    corners = surface.vertices[surface.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(surface.vertices)
    for corner in range(3):
        np.add.at(normals, surface.faces[:, corner], across)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0.0, length, 1.0)


def ellipsoid_distance(thing: ObjectShape, points: np.ndarray) -> np.ndarray:
    """[K] about the signed distance of points [K, 3] to the ellipsoid in an object's box (exact to first order)."""
    lower, upper = np.asarray(thing.lower), np.asarray(thing.upper)
    half = 0.5 * OBJECT_SHARE * (upper - lower)
    local = (points - 0.5 * (lower + upper)) / half
    norm = np.linalg.norm(local, axis=1)
    slope = np.linalg.norm(local / half, axis=1)
    return np.where(slope > 0.0, norm * (norm - 1.0) / np.where(slope > 0.0, slope, 1.0), -half.min())

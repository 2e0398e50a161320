"""People and objects of a model that follows the paper's path, for stand-ins."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from chona_model.data.dataset import Pose
from chona_model.exact_actor import ExactActor
from chona_model.geometry import box_distances, segment_distances
from chona_model.render.bounds import BODY_REACH, OBJECT_MARGIN


class ExactPart:
    """A part of an exact model.

    Args:
        actor: on any device.
        kind: ``person`` or ``object``; name: of the identity.
        pose: the canonical pose with everything that is shown together; codes and occlusion are this pose's.
    """

    def __init__(self, actor: ExactActor, kind: str, name: str, pose: Pose) -> None:
        self.kind, self.name = kind, name
        self._model = actor.model.eval()
        _, rig, self._poses = actor.figure(pose)
        with torch.no_grad():
            self._identity = self._model.codes(self._poses.persons, self._poses.objects)
        shape = self._model.shape
        if kind == "person":
            self._place = np.zeros(3)
            ends = np.concatenate([rig.rest_joints, rig.skeleton.bone_tails(rig.rest_joints)])
            lower, upper = ends.min(axis=0) - BODY_REACH, ends.max(axis=0) + BODY_REACH
        else:
            slot = list(pose.objects).index(name)
            self._place = rig.canonical_objects(shape.object_slots)[slot]
            thing = actor.objects[name]
            lower, upper = np.asarray(thing.lower) - OBJECT_MARGIN, np.asarray(thing.upper) + OBJECT_MARGIN
        self.lower = np.maximum(lower, np.array(shape.lower) - self._place)
        self.upper = np.minimum(upper, np.array(shape.upper) - self._place)

    def holds(self, points: np.ndarray) -> np.ndarray:
        within = ((points >= self.lower) & (points <= self.upper)).all(axis=1)
        if self.kind == "person":
            heads, tails = self._poses.heads[0], self._poses.tails[0]
            near = segment_distances(self._tensor(points)[:, None], heads, tails) <= BODY_REACH
            return within & near.any(dim=1).cpu().numpy()
        lower, upper = self._tensor(self.lower[None]), self._tensor(self.upper[None])
        return within & (box_distances(self._tensor(points), lower, upper) <= 0).cpu().numpy()

    def density(self, points: np.ndarray, width: float) -> np.ndarray:
        return self._ask(points, width)[1].float().cpu().numpy()

    def colour(self, points: np.ndarray, width: float) -> np.ndarray:
        return self._ask(points, width)[0].float().cpu().numpy()

    def _ask(self, points: np.ndarray, width: float) -> tuple[Tensor, Tensor]:
        """Colour [N, 3] and density [N] averaged over cubes."""
        means = self._tensor(points + self._place)
        # The Gaussian that mip-NeRF's encoding averages over has the cube's variance.
        covariances = torch.full_like(means, width**2 / 12.0)
        with torch.no_grad():
            sample = self._model.field(means, covariances, self._identity, self._poses.codes)
        return sample.rgb, sample.density

    def weights(self, points: np.ndarray) -> np.ndarray:
        if self.kind != "person":
            return np.zeros((len(points), 0), dtype=np.float32)
        with torch.no_grad():
            every = self._model.deform.skinning(self._tensor(points), self._poses.present[:1])
        # Objects and the background have no bone in an armature: what they weigh goes to the body's bones.
        body = every[:, : self._model.shape.bones].double().cpu().numpy()
        return body / np.maximum(body.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)

    def _tensor(self, points: np.ndarray) -> Tensor:
        return self._poses.heads.new_tensor(np.ascontiguousarray(points))

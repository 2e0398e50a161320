"""The actor of preset ``paper``: renders an ``ExactModel`` under render settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.actor import EMPTY_DEPTH, Picture, Samples, empty_picture, part_count
from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.data.dataset import ObjectShape, Person, Pose
from chona_model.exact import ExactModel
from chona_model.exact_shape import ExactShape
from chona_model.figure import Figure, PoseBatch, RayBatch, RayResult, Rig, make_figure, to_pose_batch
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.render.bounds import figure_spans
from chona_model.samples import join, no_samples
from chona_model.settings import RenderSettings
from chona_model.skeleton import Skeleton
from chona_model.tensor_reader import IdentityRows, TensorReader
from chona_model.upsampling import render_scaled

CONE = 2.0 / 12.0**0.5
"""mip-NeRF's base radius, in pixel widths: a disc with the variance of the square pixel."""


@dataclass(frozen=True)
class _Aim:
    """Pixels of a view whose rays meet the figure: rows, columns, near and far depths [R]; and what the model takes:
    the pose, persons [R] and objects [R, N]."""

    figure: Figure
    rows: np.ndarray
    columns: np.ndarray
    near: np.ndarray
    far: np.ndarray
    shown: tuple[PoseBatch, Tensor, Tensor]


class ExactActor:
    """A trained ``ExactModel`` with the identities it knows.

    Args:
        model: the paper's networks; skeleton, persons, objects, object_distance: what they were trained on.
    """

    kind = "exact"

    def __init__(
        self, model: ExactModel, skeleton: Skeleton, persons: Mapping[str, Person], objects: Mapping[str, ObjectShape],
        object_distance: float,
    ) -> None:  # fmt: skip
        self.model, self.skeleton, self.object_distance = model, skeleton, object_distance
        self.persons, self.objects = persons, objects
        self._double: ExactActor | None = None

    def rig(self, person: str | None) -> Rig:
        """The rig of a person; of none, one with joints at the origin, for objects alone.

        Raises:
            KeyError: the model does not know the person; the message names those it knows.
        """
        if person is None:
            return self._rig(np.zeros((len(self.skeleton), 3)))
        if person not in self.persons:
            raise KeyError(f"the model has no person '{person}'; it has: {', '.join(self.persons) or 'none'}")
        return self._rig(self.persons[person].rest_joints)

    def _rig(self, joints: np.ndarray) -> Rig:
        shape = self.model.shape
        return Rig(self.skeleton, joints, self.object_distance, shape.turns_objects, shape.reach)

    def figure(self, pose: Pose) -> tuple[Figure, Rig, PoseBatch]:
        """A pose in root space, its rig, and as tensors.

        Raises:
            KeyError: the model does not know the person or an object.
        """
        rig = self.rig(pose.person)
        unknown = [name for name in pose.objects if name not in self.objects]
        if unknown:
            raise KeyError(f"the model has no object '{unknown[0]}'; it has: {', '.join(self.objects) or 'none'}")
        slots = self.model.shape.object_slots
        figure = make_figure(rig, pose.world_from_bone if pose.person else None, pose.world_from_object, slots)
        person = list(self.persons).index(pose.person) if pose.person else -1
        things = [list(self.objects).index(name) for name in pose.objects] + [-1] * (slots - len(pose.objects))
        parameter = next(self.model.parameters())
        poses = to_pose_batch([figure], [rig], [person], [things], parameter.dtype, parameter.device)
        return figure, rig, poses

    def boxes(self, objects: Sequence[str]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Corners of the objects' boxes in their own frames, metres."""
        return [(np.asarray(self.objects[name].lower), np.asarray(self.objects[name].upper)) for name in objects]

    def render(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None = None,
        passes: Passes = DEFAULT_PASSES,
    ) -> Picture:  # fmt: skip
        """Renders a view, or some ``pixels`` [H, W] bool of it; those that miss the figure's bounds cost nothing."""
        render = partial(self._in(settings.precision)._render, passes=passes)
        return render_scaled(render, pose, camera, settings, pixels)

    def count_rays(self, pose: Pose, camera: Camera, settings: RenderSettings) -> int:
        """How many rays ``render`` would trace, without tracing any."""
        figure, rig, _ = self.figure(pose)
        near, far = figure_spans(figure, rig, self.boxes(pose.objects), camera.scaled(settings.resolution))
        return int(np.count_nonzero(far > near)) * settings.supersampling**2

    def forget_poses(self) -> None:
        """Nothing is kept from one view to the next."""

    def _in(self, precision: str) -> ExactActor:
        """This actor, or its double precision copy, which is kept."""
        if precision == "float32":
            return self
        if self._double is None:
            model = deepcopy(self.model).double()
            self._double = ExactActor(model, self.skeleton, self.persons, self.objects, self.object_distance)
        return self._double

    def _render(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None, passes: Passes
    ) -> Picture:
        aim, empty = self._aim(pose, camera, pixels), empty_picture(camera, passes, part_count(pose))
        if len(aim.rows) == 0:
            return empty
        flat = camera.kind == ORTHOGRAPHIC
        results = [
            self.model.render_rays(rays, *aim.shown, settings.exact, orthographic=flat, facing=passes.normal)
            for rays in self._rays(aim, camera, settings.supersampling)
        ]
        return _fill(empty, aim, pose, results)

    def sample(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray, passes: Passes = DEFAULT_PASSES
    ) -> Samples:
        """What the rays of ``pixels`` [H, W] bool meet, at the camera's own size."""
        actor = self._in(settings.precision)
        aim, side = actor._aim(pose, camera, pixels), settings.supersampling
        parts = [no_samples(passes, part_count(pose))]
        if len(aim.rows) == 0:
            return parts[0]
        for sub, rays in enumerate(actor._rays(aim, camera, side)):
            *found, normals = actor.model.sample_rays(
                rays, *aim.shown, settings.exact, orthographic=camera.kind == ORTHOGRAPHIC, facing=passes.normal
            )  # fmt: skip
            depth, alpha, rgb, shares = (array.float().cpu().numpy() for array in found)
            ray = np.repeat((aim.rows * camera.width + aim.columns) * side**2 + sub, depth.shape[1])
            held = alpha.ravel() > 0
            shares = shares.reshape(len(held), -1)[held]
            shares /= np.maximum(shares.sum(axis=-1, keepdims=True), 1e-12)
            normal = None
            if normals is not None:
                normal = aim.figure.turn_to_world(normals.float().cpu().numpy().reshape(-1, 3)[held])
            own = _of_pose(shares, pose) if passes.cryptomatte else None
            parts.append(
                Samples(
                    ray[held], depth.ravel()[held], alpha.ravel()[held], rgb.reshape(-1, 3)[held],
                    shares[:, 1:].sum(axis=-1), normal, own,
                )
            )  # fmt: skip
        return join(parts)

    def _aim(self, pose: Pose, camera: Camera, pixels: np.ndarray | None) -> _Aim:
        """The pixels (some of ``pixels`` [H, W] bool, None for all) whose rays meet the figure's bounds."""
        figure, rig, poses = self.figure(pose)
        near, far = figure_spans(figure, rig, self.boxes(pose.objects), camera)
        seen = far > near
        rows, columns = np.nonzero(seen if pixels is None else seen & pixels)
        self.model.eval()
        shown = (poses, poses.persons.expand(len(rows)), poses.objects.expand(len(rows), -1))
        return _Aim(figure, rows, columns, near[rows, columns], far[rows, columns], shown)

    def _rays(self, aim: _Aim, camera: Camera, side: int) -> Iterator[RayBatch]:
        """The rays through all pixels, once for each of ``side``² points of a pixel."""
        places, like = np.stack([aim.columns, aim.rows], axis=-1), next(self.model.parameters())
        for sub in range(side**2):
            shift = (np.array([sub % side, sub // side]) + 0.5) / side
            yield make_rays(aim.figure, camera, places + shift, aim.near, aim.far, like, pose=0, sharpness=side)

    def tensors(self) -> dict[str, Tensor]:
        """Parameters by name."""
        return {name: value.detach().contiguous() for name, value in self.model.state_dict().items()}

    def shape(self) -> dict[str, Any]:
        """Sizes of the networks."""
        return self.model.shape.as_dict()

    @classmethod
    def rebuild(
        cls, skeleton: Skeleton, persons: Mapping[str, Person], objects: Mapping[str, ObjectShape],
        object_distance: float, shape: dict[str, Any], tensors: TensorReader, device: str = "cpu",
        *, rows: IdentityRows,
    ) -> ExactActor:  # fmt: skip
        """Inverse of ``shape`` and ``tensors``, with some of the identities.

        The networks are shared; of the codes only those of the chosen are read, and without objects nothing of the
        pseudo bones' weights.

        Args:
            persons, objects: the chosen ones; rows: their places among all that the file holds.
        """
        whole = ExactShape.from_dict(shape)
        if (whole.bones, whole.n_persons, whole.n_objects) != (len(skeleton), rows.of_persons, rows.of_objects):
            raise ValueError("the networks have other numbers of bones, persons or objects than the metadata names")
        lower, upper = (
            tuple(corners[row] for row in rows.objects) if corners else ()
            for corners in (whole.object_lower, whole.object_upper)
        )
        wanted = replace(
            whole, n_persons=len(persons), n_objects=len(objects), object_lower=lower, object_upper=upper,
            object_slots=whole.object_slots if objects else 0,
        )  # fmt: skip
        with torch.device("meta"):  # all shapes, and no memory: what the file does not hold is never asked for
            planned, stated = ExactModel(wanted).state_dict(), ExactModel(whole).state_dict()
        for name, value in stated.items():
            tensors.expect(name, tuple(value.shape))
        state = {name: _cut(tensors, name, value.shape, whole.bones) for name, value in planned.items()
                 if not name.startswith("codes.")}  # fmt: skip
        state["codes.persons"] = tensors.rows("codes.persons", rows.persons)
        state["codes.objects"] = tensors.rows("codes.objects", rows.objects)
        model = ExactModel(wanted)
        model.load_state_dict(state)
        return cls(model.to(device), skeleton, persons, objects, object_distance)


def _cut(tensors: TensorReader, name: str, wanted: Sequence[int], bones: int) -> Tensor:
    """A layer's tensor without what belongs to the pseudo bones, where the model has room for none.

    Their codes and poses come last among a layer's inputs; among the weights that skinning gives they stand between the
    bones and the background.
    """
    held = tensors.shape(name)
    if held == tuple(wanted):
        return tensors[name]
    if held[0] != wanted[0]:
        return tensors.rows(name, [*range(bones), held[0] - 1])
    return tensors.columns(name, wanted[1])


def make_rays(
    figure: Figure, camera: Camera, pixels: np.ndarray, near: np.ndarray, far: np.ndarray, like: Tensor, *, pose: int,
    sharpness: float = 1.0,
) -> RayBatch:  # fmt: skip
    """Rays through pixels [R, 2] with cones of a pixel's width over ``sharpness``, in ``like``'s dtype and device."""
    origins, directions = figure.rays(camera, pixels)
    count = len(pixels)

    def real(array: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=like.dtype, device=like.device)

    radius = CONE / (camera.intrinsics[0, 0] * sharpness)
    return RayBatch(
        real(origins), real(directions), real(np.full(count, radius)), real(near), real(far),
        torch.full((count,), pose, dtype=torch.int64, device=like.device),
    )  # fmt: skip


def _of_pose(mattes: np.ndarray, pose: Pose) -> np.ndarray:
    """[R, P] of the pose's parts, from [R, 1 + N] of the person and every slot."""
    return mattes[:, (pose.person is None) : 1 + len(pose.objects)]


def _fill(picture: Picture, aim: _Aim, pose: Pose, results: Sequence[RayResult]) -> Picture:
    """Averages subpixel rays; depth over those that hit something, weighted by their alpha."""
    rows, columns = aim.rows, aim.columns

    def mean(name: str) -> np.ndarray:
        return np.mean([getattr(result, name).float().cpu().numpy() for result in results], axis=0)

    alphas = np.stack([result.alpha.float().cpu().numpy() for result in results])
    depths = np.stack([result.depth.float().cpu().numpy() for result in results])
    total = alphas.sum(axis=0)
    depth = np.full(len(rows), EMPTY_DEPTH, dtype=np.float32)
    solid = total > 0
    depth[solid] = (np.where(alphas > 0, depths, 0.0) * alphas).sum(axis=0)[solid] / total[solid]
    picture.depth[rows, columns] = depth
    for name in ("rgb", "alpha", "human", "object", "confidence"):
        getattr(picture, name)[rows, columns] = mean(name)
    if picture.normal is not None:
        picture.normal[rows, columns] = aim.figure.turn_to_world(mean("normal"))
    if picture.parts is not None:
        picture.parts[rows, columns] = _of_pose(mean("mattes"), pose)
    failed = float(np.mean([float(result.failed_share) for result in results]))
    return replace(picture, rays=len(rows), failed_share=failed)

"""Training of the paper's networks (preset ``paper``): exact path, three losses, CIL, exponential schedule."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from chona_model.camera import Camera
from chona_model.data.dataset import Dataset, DatasetError
from chona_model.data.soundness import check_dataset
from chona_model.deform.initialise import initialise_from_bones, initialise_from_surface
from chona_model.exact import ExactModel
from chona_model.exact_actor import ExactActor, make_rays
from chona_model.exact_shape import ExactShape
from chona_model.field.codes import draw_invariant_codes, step_generator
from chona_model.figure import Figure, PoseBatch, object_places
from chona_model.methods import METHODS, Method
from chona_model.render.bounds import figure_spans
from chona_model.render.rays import take_rays
from chona_model.settings import PREDICTED, ExactSettings, InverseSettings
from chona_model.train import together
from chona_model.train.adam_state import adam_tensors, restore_adam
from chona_model.train.errors import TrainingError, decibels, loss_not_finite
from chona_model.train.objects import object_distance
from chona_model.train.pixels import PoseViews, group_by_pose

BODY_MARGIN = 0.22
"""Canonical space reaches this far beyond joints and surface, metres."""


MIN_RAYS = 64
"""Rays of a step, however small the images."""


@dataclass(frozen=True)
class PaperSettings:
    """The paper's choices.

    Attributes:
        rays: a step, of one image at full size (BEHAVE's number); images of a share of the size take their share of
            the rays, at least ``MIN_RAYS``.
        first_rate, last_rate: Adam's, falling exponentially.
        weight_loss, offset_loss: λ and β.
        exact: the exact path's settings.
        chunk: rays whose graph is held at once; gradients of chunks are added.
        initial_steps: of fitting the skinning weights before training.
    """

    rays: int = 2048
    first_rate: float = 5e-4
    last_rate: float = 5e-6
    weight_loss: float = 1.0
    offset_loss: float = 0.1
    exact: ExactSettings = ExactSettings(bounded=True, inverse=InverseSettings(predict=PREDICTED))
    chunk: int = 256
    initial_steps: int = 400


@dataclass(frozen=True)
class _Image:
    """Reachable pixels of one view: places [K, 2], depths [K], rgb [K, 3] uint8, part [K] (1 person, 2 object).

    ``ray_share`` is the view's.
    """

    moment: int
    camera: Camera
    places: np.ndarray
    near: np.ndarray
    far: np.ndarray
    rgb: np.ndarray
    part: np.ndarray
    ray_share: float


class ExactTrainer:
    """Owns an exact model, its optimiser and the training pixels.

    Args:
        dataset: what to learn from; settings: how.
        seed: of everything random, together with the step.
        device: where to compute; image_scale: size of the images used.
        method: what of objects' motion is told, and whether there is compositional invariant learning.

    Raises:
        DatasetError: no views, numbers that are not finite, or no view shows the figure.
    """

    def __init__(
        self, dataset: Dataset, settings: PaperSettings, seed: int, device: str = "cpu", image_scale: float = 1.0,
        method: Method = METHODS["chona"], shape: ExactShape | None = None,
    ) -> None:  # fmt: skip
        if method.distances:
            raise TrainingError(f"the method {method.name} is trained with preset fast; choose it with --preset fast")
        dataset = method.dataset(dataset)
        check_dataset(dataset)
        groups = group_by_pose(dataset, image_scale)
        torch.manual_seed(seed)
        self.settings, self.seed, self.method = settings, seed, method
        self.rays = settings.rays * image_scale**2
        distance = object_distance(dataset)
        told = {"turns_objects": method.objects != "placed", "reach": method.reach}
        shape = replace(shape or make_shape(dataset, distance, method.reach), **told)  # type: ignore[arg-type]
        model = ExactModel(shape).to(device)
        persons, objects = dict(dataset.persons), dict(dataset.objects)
        self._actor = ExactActor(model, dataset.skeleton, persons, objects, distance)
        self._initialise(dataset)
        prepared = [self._actor.figure(group.views[0].pose) for group in groups]
        self.figures: list[Figure] = [figure for figure, _, _ in prepared]
        self.poses: list[PoseBatch] = [poses for _, _, poses in prepared]
        rigs = [rig for _, rig, _ in prepared]
        self.images = [image for index, group in enumerate(groups) for image in self._images(index, group, rigs[index])]
        if not self.images:
            raise DatasetError("no view shows the figure; check cameras and poses with 'chona check-data'")
        self.optimiser = torch.optim.Adam(model.parameters(), lr=settings.first_rate)

    def _initialise(self, dataset: Dataset) -> None:
        """Skinning weights of the first person, whose canonical space all persons share."""
        model, shape = self._actor.model, self._actor.model.shape
        if not dataset.persons:
            return
        person = next(iter(dataset.persons.values()))
        rig = self._actor.rig(person.name)
        boxes = self._actor.boxes(list(dataset.objects))
        lower = np.min([box[0] for box in boxes], axis=0) if boxes else np.zeros(3)
        upper = np.max([box[1] for box in boxes], axis=0) if boxes else np.zeros(3)
        slots = [(lower + place, upper + place) for place in rig.canonical_objects(shape.object_slots)]
        extent = {"lower": np.array(shape.lower), "upper": np.array(shape.upper)}
        budget = {"steps": self.settings.initial_steps, "seed": self.seed}
        skinning = model.deform.skinning
        if person.surface is not None:
            initialise_from_surface(skinning, person.surface, slots, **extent, **budget)  # type: ignore[arg-type]
        else:
            tails = dataset.skeleton.bone_tails(person.rest_joints)
            initialise_from_bones(skinning, person.rest_joints, tails, slots, **extent, **budget)  # type: ignore[arg-type]

    def _images(self, moment: int, group: PoseViews, rig: object) -> list[_Image]:
        found = []
        for view, pixels in zip(group.views, group.pixels, strict=True):
            boxes = self._actor.boxes(view.pose.objects)
            near, far = figure_spans(self.figures[moment], rig, boxes, view.camera)  # type: ignore[arg-type]
            rows, columns = np.nonzero(far > near)
            if len(rows) == 0:
                continue
            part = pixels.person[rows, columns] + 2 * pixels.object[rows, columns].astype(np.int8)
            rgb = np.round(pixels.rgb[rows, columns] * 255).astype(np.uint8)
            places = np.stack([columns, rows], axis=-1).astype(np.int16)
            found.append(
                _Image(
                    moment, view.camera, places, near[rows, columns], far[rows, columns], rgb, part.astype(np.int8),
                    view.ray_share,
                )
            )  # fmt: skip
        return found

    def step(self, index: int, share: float) -> dict[str, float]:
        """One optimisation step on rays of one image.

        Args:
            index: number of the step; share: how much of the schedule is done, 0…1.

        Raises:
            TrainingError: the loss is not finite.
        """
        settings, model = self.settings, self._actor.model
        random = np.random.default_rng([self.seed, index])
        image = self.images[random.integers(len(self.images))]
        pick = random.integers(len(image.places), size=max(MIN_RAYS, round(self.rays * image.ray_share)))
        poses, like = self.poses[image.moment], next(model.parameters())
        mine = together.mine(len(pick))
        far = np.where(mine, image.far[pick], image.near[pick])  # the others' rays miss, which costs nothing
        rays = make_rays(
            self.figures[image.moment], image.camera, image.places[pick] + 0.5, image.near[pick], far, like, pose=0
        )
        part = torch.as_tensor(image.part[pick], device=like.device)
        persons, objects = poses.persons.expand(len(pick)), poses.objects.expand(len(pick), -1)
        if self.method.invariant_codes:
            persons, objects = draw_invariant_codes(
                persons, objects, part == 1, part == 2, n_persons=model.shape.n_persons,
                n_objects=model.shape.n_objects, seed=self.seed, step=index,
            )  # fmt: skip
        target = np.where((image.part[pick] > 0)[:, None], image.rgb[pick] / 255.0, 0.0)
        goal = torch.as_tensor(np.where(mine[:, None], target, 0.0), dtype=like.dtype, device=like.device)
        model.train()
        self.optimiser.zero_grad(set_to_none=True)
        generator = step_generator(self.seed, index)
        total = image_total = 0.0
        weight_loss, offset_loss = settings.weight_loss * together.share(), settings.offset_loss * together.share()
        for begin in range(0, len(pick), settings.chunk):
            rows = slice(begin, begin + settings.chunk)
            fraction = len(pick[rows]) / len(pick)
            subset = take_rays(rays, torch.arange(len(pick), device=like.device)[rows])
            result = model.render_rays(subset, poses, persons[rows], objects[rows], settings.exact, generator)
            image_loss = ((result.rgb - goal[rows]) ** 2).mean()
            terms = result.regularisers
            loss = image_loss + weight_loss * terms["weights"] + offset_loss * terms["offset"]
            if not torch.isfinite(loss):
                raise TrainingError(loss_not_finite(index, float(loss.detach()), self.rates))
            (fraction * loss).backward()
            total += fraction * float(loss.detach())
            image_total += fraction * float(image_loss.detach())
        total, image_total = together.sums(total, image_total)
        together.add_up(list(model.parameters()))
        for group in self.optimiser.param_groups:
            group["lr"] = settings.first_rate * (settings.last_rate / settings.first_rate) ** min(share, 1.0)
        self.optimiser.step()
        return {"loss": total, "psnr": decibels(image_total), "empty_psnr": decibels(float((target**2).mean()))}

    def actor(self) -> ExactActor:
        """The model as it is now."""
        return self._actor

    @property
    def rates(self) -> str:
        """The rates it was told, in words."""
        return f"first_rate {self.settings.first_rate:g}"

    def tensors(self) -> dict[str, Tensor]:
        """Everything that later steps depend on, by name; not copied."""
        model = {f"model.{name}": value for name, value in self._actor.model.state_dict().items()}
        return model | adam_tensors(self.optimiser)

    def state(self) -> dict[str, Tensor]:
        """A copy of ``tensors``."""
        return {name: value.detach().clone().contiguous() for name, value in self.tensors().items()}

    def restore(self, state: dict[str, Tensor], done: int) -> None:  # noqa: ARG002 - the loop's interface
        """Continues from ``state``."""
        model = {name.removeprefix("model."): value for name, value in state.items() if name.startswith("model.")}
        self._actor.model.load_state_dict(model)
        restore_adam(self.optimiser, state)


def make_shape(dataset: Dataset, distance: float, reach: float = 0.0) -> ExactShape:
    """Canonical space around all persons in T-pose, ``reach`` metres wider, and all objects in front of them."""
    slots = max(max((len(view.pose.objects) for view in dataset.views), default=0), 1)
    points = [np.zeros((1, 3))]
    roots = [np.zeros(3)]
    for person in dataset.persons.values():
        points += [person.rest_joints, dataset.skeleton.bone_tails(person.rest_joints)]
        points += [person.surface.vertices] if person.surface is not None else []
        roots.append(person.rest_joints[0])
    for root in roots[1:] or roots:
        for thing in dataset.objects.values():
            for place in object_places(distance, slots):
                points.append(np.stack([thing.lower, thing.upper]) + root + place)
    everything = np.concatenate(points[1:] if len(points) > 1 else points)
    margin = BODY_MARGIN + reach
    lower, upper = everything.min(axis=0) - margin, everything.max(axis=0) + margin
    return ExactShape(
        bones=len(dataset.skeleton), object_slots=slots, n_persons=len(dataset.persons),
        n_objects=len(dataset.objects), lower=_corner(lower), upper=_corner(upper),
        object_distance=distance, object_lower=tuple(_corner(thing.lower) for thing in dataset.objects.values()),
        object_upper=tuple(_corner(thing.upper) for thing in dataset.objects.values()),
    )  # fmt: skip


def _corner(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])

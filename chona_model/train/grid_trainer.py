"""Training of grid models (preset ``fast``): the paper's losses, CIL and schedule on the fast path."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from chona_model.data.dataset import Dataset, DatasetError
from chona_model.data.soundness import check_dataset
from chona_model.grid_actor import GridActor
from chona_model.grid_inputs import occupied_cells, starts_of, surfaces_of
from chona_model.grid_model import GridModel, GridModelShape
from chona_model.kernels.cpu.advance import Starts
from chona_model.kernels.grid import fast
from chona_model.methods import METHODS, Method
from chona_model.render.occupancy import CULL_DENSITY, CULL_SHARE, FADE
from chona_model.render.posed import PosedPart
from chona_model.train import together
from chona_model.train.batch import Batch, DrawnRays, trace_fused, trace_staged
from chona_model.train.distance import DistanceField
from chona_model.train.errors import TrainingError, decibels, density_not_finite, likely_causes, loss_not_finite
from chona_model.train.fast_settings import FastSettings
from chona_model.train.first_model import first_model
from chona_model.train.grid_optimiser import GridOptimiser
from chona_model.train.hull import carve_hull
from chona_model.train.pixels import ViewPool, group_by_pose, make_pools
from chona_model.train.ray_codes import ray_codes
from chona_model.train.skinning_loss import SkinningLoss

KEPT_MATRICES = 64
"""Poses whose blended matrices are kept: two megabytes each."""


def _wrong_part(out: Tensor, part: Tensor) -> Tensor:
    """[R] squared opacity that lies on the wrong part; ``part`` is 0 (neither), 1 (person) or 2 (object)."""
    thing = out[:, 5]
    wrong = torch.where(part == 1, thing, torch.where(part == 2, out[:, 3] - thing, 0.0))
    return wrong**2


def _ends(drawn: list[DrawnRays]) -> np.ndarray:
    """Where the rays of one pose end and those of the next begin."""
    return np.cumsum([len(rays) for rays in drawn])[:-1]


class GridTrainer:
    """Owns a model, its optimisers and the training pixels.

    Args:
        dataset: what to learn from.
        settings: how; shape: sizes of the model.
        seed: of everything random, together with the step.
        image_scale: size of the images used.
        method: what of objects' motion is told, and whether there is compositional invariant learning.
        base: a model that stays as it is, to which the dataset's identities are added (see ``grid_growth``).
        device, dtype: float32 on the CPU is for the fused kernels; anything else takes the stages of tensors.

    Raises:
        DatasetError: no views, numbers that are not finite, or nothing inside the masks' visual hull.
    """

    def __init__(
        self, dataset: Dataset, settings: FastSettings, seed: int, image_scale: float = 1.0,
        method: Method = METHODS["chona"], shape: GridModelShape | None = None, device: str = "cpu",
        dtype: torch.dtype = torch.float32, base: GridModel | None = None,
    ) -> None:  # fmt: skip
        dataset = method.dataset(dataset)
        check_dataset(dataset)
        self.groups = group_by_pose(dataset, image_scale)
        torch.manual_seed(seed)
        self.settings, self.seed, self.method = settings, seed, method
        guessed = any(person.surface is None for person in dataset.persons.values())
        self.learns_skinning = guessed or settings.refine_given_weights
        self.model = first_model(dataset, method, shape, base)
        persons = {self.model.person_index(name): name for name in dataset.persons}
        first = len(self.model.persons)
        self.parts = persons | {first + self.model.object_index(name): name for name in dataset.objects}
        self.posed = [self.model.posed(group.views[0].pose) for group in self.groups]
        images = [list(zip(group.views, group.pixels, strict=True)) for group in self.groups]
        carve_hull(self.model, self.posed, images, tuple(self.parts))
        empty = [name for part, name in self.parts.items() if len(self.model.occupancy.occupied(part)) == 0]
        if empty:
            raise DatasetError(
                f"the masks leave no room for {', '.join(empty)}: no point falls inside them in every view; check "
                "cameras, poses and masks with 'chona check-data'"
            )
        self.model.to(device=device, dtype=dtype)
        self.fused = fast(self.model.field.lower)
        self._rebuild()
        if len(self.usable) == 0:
            raise DatasetError("no view shows the figure; check cameras and poses with 'chona check-data'")
        self.distances = DistanceField(self.model, self._usual_pair, seed) if method.distances else None
        if self.distances is not None:
            self.distances.begin(GridOptimiser(self.model, settings, self.fused))
        self.optimiser = GridOptimiser(self.model, settings, self.fused, None if base is None else list(persons))
        self.skinning_loss = SkinningLoss(self.model, dataset, settings)

    def _rebuild(self) -> None:
        """Posed grids and pools from occupancy and skinning as they are now, which are noted for resuming."""
        self.built_from = {name: value.detach().clone() for name, value in self.model.volumes.state_dict().items()}
        if not all(bool(torch.isfinite(value).all()) for value in self.built_from.values()):
            # A cell that is posed at NaN would be written anywhere in memory.
            raise TrainingError(f"the skinning is not finite any more; {likely_causes(self.rates)}")
        self.built_from["densities"] = torch.from_numpy(self.model.occupancy.densities.copy())
        cells = self.model.cells(self.model.occupancy)
        parts = [self.model.pose_cells(pose, cells) for pose in self.posed]
        self.surfaces = surfaces_of(self.model.occupancy)
        # A posed grid takes megabytes, its occupied cells a tenth of that: kernels keep those alone.
        self.grids: list[Starts] | list[PosedPart] = [starts_of(part) for part in parts] if self.fused else parts
        self.pools = make_pools(parts, self.posed, self.groups)
        self._forget_matrices()
        self.usable = np.array([index for index, row in enumerate(self.pools) if row])

    def step(self, index: int, share: float) -> dict[str, float]:
        """One optimisation step.

        Args:
            index: number of the step, from 0; with the seed it decides everything random.
            share: how much of the schedule is done, 0…1.

        Returns:
            ``loss`` and ``psnr`` of the batch, and ``empty_psnr`` of an empty picture on the same rays.

        Raises:
            TrainingError: the loss is not finite.
        """
        settings, real = self.settings, self.model.real
        random = np.random.default_rng([self.seed, index])
        chosen = random.choice(self.usable, min(settings.poses, len(self.usable)), replace=False)
        drawn = [self._draw(pose, settings.rays // len(chosen), random) for pose in chosen]
        rgb, part = (np.concatenate([getattr(rays, name) for rays in drawn]) for name in ("rgb", "part"))
        pose = np.repeat(chosen, [len(rays) for rays in drawn])
        skinning = self.learns_skinning and share >= settings.skin_from and index % settings.skin_every == 0
        figures = [self.posed[number] for number in chosen]
        mine = together.mine(len(part))
        drawn = [rays.only(own) for rays, own in zip(drawn, np.split(mine, _ends(drawn)), strict=True)]
        pairs, ray_pair = ray_codes(
            self.model, self.posed, pose, part, exchange=self.method.invariant_codes, seed=self.seed, step=index
        )
        batch = Batch(
            figures, [self.grids[number] for number in chosen], drawn, random.random(len(part), dtype=np.float32),
            ray_pair, pairs, real(np.stack([figure.code for figure in figures])), self.model.root_light(figures),
        )  # fmt: skip
        tracing = settings.trace if share < settings.fine_from else settings.fine_trace
        if self.fused:
            out = trace_fused(self.model, batch, self._matrices(chosen, skinning), self.surfaces, tracing)
        else:
            out = trace_staged(self.model, batch, skinning, self.surfaces, tracing)
        background = np.zeros((len(part), 3), np.float32)
        if settings.random_background:
            background = random.random((len(part), 3)).astype(np.float32)
        target = np.where((mine & (part > 0))[:, None], rgb.astype(np.float32) / 255.0, background)
        predicted = out[:, :3] + (1.0 - out[:, 3:4]) * real(background)
        image_loss = ((predicted - real(target)) ** 2).mean()
        loss = image_loss + settings.part_loss * _wrong_part(out, torch.as_tensor(part, device=out.device)).mean()
        if skinning:
            loss = loss + together.share() * self.skinning_loss(figures)
        if self.distances is not None:
            loss = loss + together.share() * self.distances.eikonal(index)
        empty = float(((target - background) ** 2).mean())
        total, image_total, empty = together.sums(float(loss.detach()), float(image_loss.detach()), empty)
        if not math.isfinite(total):
            raise TrainingError(loss_not_finite(index, total, self.rates))
        self.optimiser.clear()
        loss.backward()
        together.add_up(self.optimiser.parameters, self.model.field.gradient if self.fused else None)
        self.optimiser.step(index, share)
        if skinning:
            self._forget_matrices()
        self._follow_density(index + 1)
        return {"loss": total, "psnr": decibels(image_total), "empty_psnr": decibels(empty)}

    def _matrices(self, chosen: np.ndarray, skinning: bool) -> list[Tensor]:
        """Blended matrices of each pose; those that need no gradient are kept until the skinning changes."""
        if skinning:
            return [self.model.matrices([self.posed[pose]])[0] for pose in chosen]
        for pose in map(int, chosen):
            if pose not in self._kept:
                if len(self._kept) >= KEPT_MATRICES:
                    self._kept.pop(next(kept for kept in self._kept if kept not in chosen))
                with torch.no_grad():
                    self._kept[pose] = self.model.rendering_matrices(self.posed[pose])
        return [self._kept[int(pose)] for pose in chosen]

    def _forget_matrices(self) -> None:
        self._kept: dict[int, Tensor] = {}
        for index in range(len(self.model.persons)):
            self.model.volume(index).rendering_weights = None

    def _draw(self, pose: int, count: int, random: np.random.Generator) -> DrawnRays:
        """Rays of one pose from one of its views, jittered inside their pixels; ``count`` of a BEHAVE image."""
        pool: ViewPool = self.pools[pose][random.integers(len(self.pools[pose]))]
        pick = random.integers(len(pool.rows), size=max(1, round(count * pool.ray_share)))
        places = np.stack([pool.columns[pick], pool.rows[pick]], axis=-1) + random.random((len(pick), 2))
        origins, directions = self.posed[pose].figure.rays(pool.camera, places)
        return DrawnRays(
            origins.astype(np.float32), directions.astype(np.float32), pool.near[pick], pool.far[pick], pool.rgb[pick],
            pool.part[pick],
        )  # fmt: skip

    def _follow_density(self, done: int) -> None:
        """Refreshes cached densities from the field, and the posed grids at their appointed steps."""
        if self.settings.cull_from <= done <= self.settings.cull_until and done % self.settings.cull_every == 0:
            random = np.random.default_rng([self.seed, done, 1])
            for part in self.parts:
                self._refresh(part, random)
            together.copy_of_leader(self.model.occupancy.densities)
            self.surfaces = replace(self.surfaces, occupied=occupied_cells(self.model.occupancy))
        if done in self.settings.rebuild:
            self._rebuild()

    def _refresh(self, part: int, random: np.random.Generator) -> None:
        occupancy = self.model.occupancy
        own = slice(occupancy.first[part], occupancy.first[part + 1])
        cells = np.flatnonzero(occupancy.support[own])
        points = occupancy.centres(part, cells)
        points += (random.random(points.shape, dtype=np.float32) - np.float32(0.5)) * np.float32(occupancy.cell)
        pair = self._usual_pair(part).to(self.model.device)
        density = self.model.field.density(
            self.model.real(points), torch.full((len(points),), part, dtype=torch.int32, device=pair.device), pair,
            torch.zeros(len(points), dtype=torch.int64, device=pair.device),
        ).float().cpu()  # fmt: skip
        if not bool(torch.isfinite(density).all()):
            raise TrainingError(density_not_finite(self.parts[part], self.rates))
        cached = np.maximum(occupancy.densities[own][cells] * FADE, density.numpy())
        limit = min(CULL_DENSITY, CULL_SHARE * float(cached.max()))
        occupancy.densities[own][cells] = np.where(cached < limit, 0.0, cached)

    def _usual_pair(self, part: int) -> Tensor:
        """A pair [1, 2] that training has seen with this part: codes of absent identities may never be trained."""
        for figure in self.posed:
            thing = figure.objects[0] if figure.objects else -1
            if figure.person == part or (thing >= 0 and len(self.model.persons) + thing == part):
                return torch.tensor([self.model.pair(figure.person, thing, of_object=figure.person != part)])
        persons = len(self.model.persons)
        return torch.tensor([[part, -1] if part < persons else [-1, part - persons]])

    def actor(self) -> GridActor:
        """The model as it is now."""
        return GridActor(self.model)

    @property
    def rates(self) -> str:
        """The rates it was told, in words."""
        names = ("grid_rate", "mlp_rate", "light_rate", "skin_rate", "offset_rate")
        return ", ".join(f"{name} {getattr(self.settings, name):g}" for name in names)

    def tensors(self) -> dict[str, Tensor]:
        """Everything that later steps depend on, by name; not copied."""
        tensors = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        tensors |= {f"built.{name}": value for name, value in self.built_from.items()}
        tensors["occupancy"] = torch.from_numpy(self.model.occupancy.densities)
        return tensors | self.optimiser.tensors()

    def state(self) -> dict[str, Tensor]:
        """A copy of ``tensors``."""
        return {name: value.detach().clone().contiguous() for name, value in self.tensors().items()}

    def restore(self, state: dict[str, Tensor], done: int) -> None:  # noqa: ARG002 - the loop's interface
        """Continues from ``state``."""
        built = {name.removeprefix("built."): value for name, value in state.items() if name.startswith("built.")}
        self.model.occupancy.densities[:] = built.pop("densities").numpy()
        self.model.volumes.load_state_dict(built)
        self._rebuild()
        self.model.load_state_dict({name[6:]: value for name, value in state.items() if name.startswith("model.")})
        self.optimiser.restore(state)
        self.model.occupancy.densities[:] = state["occupancy"].numpy()
        self.surfaces = replace(self.surfaces, occupied=occupied_cells(self.model.occupancy))
        self._forget_matrices()

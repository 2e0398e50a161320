"""The actor of preset ``fast``: renders a ``GridModel`` under render settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from chona_model.actor import EMPTY_DEPTH, Picture, Samples, empty_picture, part_count
from chona_model.camera import Camera
from chona_model.data.dataset import ObjectShape, Person, Pose
from chona_model.deform.voxels import NodeGrid
from chona_model.grid_checks import check_nodes, check_tensors, checked_sizes
from chona_model.grid_device import DevicePose, make_device_pose, render_on_device, sample_on_device
from chona_model.grid_inputs import Surfaces, surfaces_for
from chona_model.grid_model import GridModel
from chona_model.grid_view import ReadyPose, View, make_ready, render_view, sample_view
from chona_model.kernels.grid import fast, layout_of, make_layout
from chona_model.passes import DEFAULT_PASSES, Passes
from chona_model.render.occupancy import Occupancy, PartCells, make_coarser, whole_support, without_thin
from chona_model.render.posed import depth_spans, window_of
from chona_model.samples import join, no_samples
from chona_model.settings import RenderSettings
from chona_model.skeleton import Skeleton
from chona_model.tensor_reader import IdentityRows, TensorReader
from chona_model.upsampling import render_scaled

TILE = 1 << 19
"""Pixels looked at together at most: what rays need beyond the picture itself stays under 100 MB."""

OF_IDENTITIES = frozenset({"table", "lower", "person_codes", "object_codes"})
"""What of the field is kept by identity, or made from sizes."""

KEPT_POSES = 4
"""Poses that stay ready: the cameras and presets of one moment."""


class GridActor:
    """A trained ``GridModel`` and how to look at it.

    Attributes:
        tile: pixels looked at together at most; the picture is the same.
    """

    kind = "grid"

    def __init__(self, model: GridModel) -> None:
        self.model = model.eval()
        self.skeleton: Skeleton = model.skeleton
        self.persons: Mapping[str, Person] = {person.name: person for person in model.persons}
        self.objects: Mapping[str, ObjectShape] = {thing.name: thing for thing in model.objects}
        self.object_distance = model.object_distance
        self._poses: dict[tuple[Any, ...], ReadyPose | DevicePose] = {}
        self._cells: dict[tuple[bool, float, int], tuple[Occupancy, Surfaces, list[PartCells]]] = {}
        self._double: GridActor | None = None
        self.tile = TILE

    def render(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None = None,
        passes: Passes = DEFAULT_PASSES,
    ) -> Picture:  # fmt: skip
        """Renders a view, or some ``pixels`` [H, W] bool of it.

        Raises:
            KeyError: the pose names an identity the model does not know.
        """
        render = partial(self._in(settings.precision)._render, passes=passes)
        return render_scaled(render, pose, camera, settings, pixels)

    def sample(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray, passes: Passes = DEFAULT_PASSES
    ) -> Samples:
        """What the rays of ``pixels`` [H, W] bool meet, at the camera's own size."""
        actor = self._in(settings.precision)
        ready = actor.ready(pose, settings)
        look: Any = sample_view if isinstance(ready, ReadyPose) else sample_on_device
        window = window_of(ready.part, ready.figure.figure, camera)
        bands = [look(actor.model, ready, camera, settings, band, pixels, passes) for band in window.bands(actor.tile)]
        return join([no_samples(passes, part_count(pose)), *bands])

    def count_rays(self, pose: Pose, camera: Camera, settings: RenderSettings) -> int:
        """How many rays ``render`` would trace, without tracing any."""
        camera = camera.scaled(settings.resolution)
        ready = self._in(settings.precision).ready(pose, settings)
        near, far = depth_spans(
            ready.part, ready.figure.figure, camera, window_of(ready.part, ready.figure.figure, camera)
        )
        return int(np.count_nonzero(far > near)) * settings.supersampling**2

    def _in(self, precision: str) -> GridActor:
        """This actor, or its double precision copy, which is kept."""
        if precision == "float32":
            return self
        if self._double is None:
            self._double = GridActor(deepcopy(self.model).double())
        self._double.tile = self.tile
        return self._double

    def _render(
        self, pose: Pose, camera: Camera, settings: RenderSettings, pixels: np.ndarray | None, passes: Passes
    ) -> Picture:
        ready, picture, rays = self.ready(pose, settings), empty_picture(camera, passes, part_count(pose)), 0
        roots = np.zeros(2)
        for band in window_of(ready.part, ready.figure.figure, camera).bands(self.tile):
            look: Any = render_view if isinstance(ready, ReadyPose) else render_on_device
            view = look(self.model, ready, camera, settings, band, pixels, passes)
            _fill(picture, view, pose)
            rays += len(view.rows)
            roots += view.values[:, 6:8].sum(axis=0, dtype=np.float64)
        return replace(picture, rays=rays, failed_share=float(roots[0] / max(roots[1], 1.0)))

    @property
    def fused(self) -> bool:
        """Whether the processor's kernels take the model: float32 on the CPU. Otherwise stages of tensors do."""
        return fast(self.model.field.lower)

    def forget_poses(self) -> None:
        """Makes the next pose ready anew."""
        self._poses.clear()

    def ready(self, pose: Pose, settings: RenderSettings) -> ReadyPose | DevicePose:
        """The pose made ready; the last few are kept, for several cameras and settings."""
        bones = None if pose.world_from_bone is None else pose.world_from_bone.tobytes()
        cells = (settings.occupancy, settings.occupancy_threshold, settings.occupancy_cell)
        shown = (pose.person, pose.objects, settings.offset, settings.shading, settings.starts)
        key = (bones, pose.world_from_object.tobytes(), *shown, *cells)
        if key not in self._poses:
            while len(self._poses) >= KEPT_POSES:
                self._poses.pop(next(iter(self._poses)))
            posed = self.model.posed(pose)
            make = make_ready if self.fused else make_device_pose
            self._poses[key] = make(self.model, posed, *self._occupied(*cells), settings)
        return self._poses[key]

    def _occupied(
        self, skip_empty: bool, threshold: float, coarser: int
    ) -> tuple[Occupancy, Surfaces, list[PartCells]]:
        key = (skip_empty, threshold, coarser)
        if key not in self._cells:
            own = self.model.occupancy
            occupancy = without_thin(own, threshold) if skip_empty else whole_support(own)
            occupancy = make_coarser(occupancy, coarser)
            self._cells[key] = occupancy, surfaces_for(occupancy, own, coarser), self.model.cells(occupancy)
        return self._cells[key]

    def tensors(self) -> dict[str, Tensor]:
        """Parameters by identity, so that a scene reads only those it shows; and what frames them."""
        model = self.model
        result: dict[str, Tensor] = {}
        for name, value in model.field.state_dict().items():
            if name not in OF_IDENTITIES:
                result[f"field.{name}"] = value
        for part, identity in enumerate(self._identities()):
            result[f"{identity}.table"] = model.field.table[model.field.table_of[part]].detach().clone()
            result[f"{identity}.density"] = torch.from_numpy(model.occupancy.part(part)).clone()
            support = model.occupancy.support[model.occupancy.first[part] : model.occupancy.first[part + 1]]
            result[f"{identity}.support"] = torch.from_numpy(support).clone()
        result |= {
            "codes.persons": model.field.person_codes.detach(),
            "codes.objects": model.field.object_codes.detach(),
        }
        for index, person in enumerate(model.persons):
            grid = model.grid(index)
            prefix = f"person.{person.name}"
            result[f"{prefix}.nodes"] = torch.from_numpy(grid.nodes)
            result[f"{prefix}.points"] = torch.from_numpy(grid.points)
            for name, value in model.volumes[index].state_dict().items():
                result[f"{prefix}.skin.{name}"] = value
        return {name: value.contiguous() for name, value in result.items()}

    def _identities(self) -> list[str]:
        return [f"person.{name}" for name in self.persons] + [f"object.{name}" for name in self.objects]

    def shape(self) -> dict[str, Any]:
        """Sizes and frames from which the actor is rebuilt."""
        model = self.model
        return {
            "sizes": asdict(model.shape),
            "tables": {"dims": model.field.layout.dims.tolist(), "lower": model.field.lower.tolist()},
            "parts": [
                {"lower": lower.tolist(), "upper": upper.tolist()} for lower, upper in zip(*model.boxes, strict=True)
            ],
            "grids": [
                {"origin": model.grid(i).origin.tolist(), "dims": model.grid(i).dims.tolist()}
                for i in range(len(model.persons))
            ],
        }

    @classmethod
    def rebuild(
        cls, skeleton: Skeleton, persons: Mapping[str, Person], objects: Mapping[str, ObjectShape],
        object_distance: float, shape: dict[str, Any], tensors: TensorReader, device: str = "cpu",
        *, rows: IdentityRows,
    ) -> GridActor:  # fmt: skip
        """Inverse of ``shape`` and ``tensors``, with some of the identities: nothing of the others is read.

        Args:
            persons, objects: the chosen ones; rows: their places among all that the file holds.
        """
        sizes = checked_sizes(shape, rows.of_persons, rows.of_objects)
        places = (*rows.persons, *(rows.of_persons + row for row in rows.objects))
        prefixes = (*(f"person.{name}" for name in persons), *(f"object.{name}" for name in objects))
        check_tensors(sizes, shape, tensors, len(skeleton), dict(zip(prefixes, places, strict=True)), rows)
        if not objects and len(shape["parts"]) > rows.of_persons:
            sizes = replace(sizes, object_slots=0)
        grids = [
            NodeGrid(
                np.array(values["origin"]), sizes.node_cell, np.array(values["dims"]),
                tensors[f"person.{name}.nodes"].numpy(), tensors[f"person.{name}.points"].numpy(),
            )
            for name, values in zip(persons, (shape["grids"][row] for row in rows.persons), strict=True)
        ]  # fmt: skip
        for name, grid in zip(persons, grids, strict=True):
            check_nodes(name, grid.nodes, len(grid.points))
        lower, upper = (np.array([part[corner] for part in shape["parts"]]) for corner in ("lower", "upper"))
        boxes = (lower[list(places)], upper[list(places)])
        model = GridModel(skeleton, persons, objects, object_distance, sizes, grids, boxes)
        actor = cls(model)
        actor._lay_out(shape, (upper - lower).max(axis=0), rows)
        actor._take(tensors, rows)
        model.to(device)
        return actor

    def _lay_out(self, shape: dict[str, Any], largest: np.ndarray, rows: IdentityRows) -> None:
        """Every part's table is laid out over the ``largest`` box of all that were trained together, not of those
        that were chosen."""
        field, sizes = self.model.field, self.model.field.shape
        if "tables" not in shape:  # as earlier versions wrote it
            extent = np.array(shape.get("extent", largest))
            field.layout = make_layout(extent, sizes.coarsest, sizes.finest, sizes.levels, 1 << sizes.rows)
            return
        field.layout = layout_of(np.array(shape["tables"]["dims"]), sizes.coarsest, sizes.finest, 1 << sizes.rows)
        if sizes.joint:
            lower = torch.tensor(shape["tables"]["lower"])
            kinds = [row for row, chosen in enumerate((rows.persons, rows.objects)) if chosen or len(lower) == 1]
            field.lower.copy_(lower[kinds[: len(field.lower)]])

    @torch.no_grad()
    def _take(self, tensors: TensorReader, rows: IdentityRows) -> None:
        """Fills the model with the tensors of its identities."""
        model, field, occupancy = self.model, self.model.field, self.model.occupancy
        for part, identity in enumerate(self._identities()):
            field.table[field.table_of[part]] = tensors[f"{identity}.table"]
            begin, end = occupancy.first[part], occupancy.first[part + 1]
            occupancy.densities[begin:end] = tensors[f"{identity}.density"].numpy()
            occupancy.support[begin:end] = tensors[f"{identity}.support"].numpy()
        # The last numbers of a pose code are the pseudo bones': without objects nothing is kept of their weights.
        cut = {"pose_in.weight", "offset_mix.0.weight"}

        def own(prefix: str) -> dict[str, Tensor]:
            return {
                name: tensors.columns(prefix + name, model.code_size) if name in cut else tensors[prefix + name]
                for name in tensors.under(prefix)
            }

        missing, unknown = field.load_state_dict(own("field."), strict=False)
        lost = [*(name for name in missing if name not in OF_IDENTITIES), *unknown]
        if lost:
            raise ValueError(f"'field.{lost[0]}' is missing, or one too many")
        field.person_codes = nn.Parameter(_codes(tensors, "codes.persons", rows.persons))
        field.object_codes = nn.Parameter(_codes(tensors, "codes.objects", rows.objects))
        for index, name in enumerate(self.persons):
            model.volumes[index].load_state_dict(own(f"person.{name}.skin."))


def _codes(tensors: TensorReader, name: str, rows: Sequence[int]) -> Tensor:
    """Identity codes; where there is no identity, the zeros that an absent one has."""
    return tensors.rows(name, rows).float() if rows else torch.zeros(1, tensors.shape(name)[1])


def _fill(picture: Picture, view: View, pose: Pose) -> None:
    """Writes what rays found to their pixels."""
    rows, columns, values = view.rows, view.columns, view.values
    alpha = np.clip(values[:, 3], 0.0, 1.0)
    solid = alpha > 0
    depth = np.full(len(rows), EMPTY_DEPTH, dtype=np.float32)
    depth[solid] = values[solid, 4] / values[solid, 3]
    thing = np.clip(values[:, 5], 0.0, alpha)
    picture.rgb[rows, columns] = values[:, :3]
    picture.alpha[rows, columns] = alpha
    picture.depth[rows, columns] = depth
    picture.object[rows, columns] = thing
    picture.human[rows, columns] = alpha - thing
    picture.confidence[rows, columns] = 1.0 - values[:, 6] / np.maximum(values[:, 7], 1.0)
    if picture.normal is not None:
        picture.normal[rows, columns] = view.normal
    if picture.parts is not None:
        alone = [*([alpha - thing] * (pose.person is not None)), *([thing] * len(pose.objects))]
        picture.parts[rows, columns] = np.stack(alone, axis=-1) if view.parts is None else view.parts

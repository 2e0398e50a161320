"""The actor of preset ``fast``: renders a ``GridModel`` under render settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import Tensor

from chona_model.actor import EMPTY_DEPTH, Picture, empty_picture, enlarge
from chona_model.camera import Camera
from chona_model.data.dataset import ObjectShape, Person, Pose
from chona_model.deform.voxels import NodeGrid
from chona_model.field.grid import GridShape
from chona_model.grid_model import GridModel, GridModelShape, PosedFigure
from chona_model.kernels.warp import NewtonLimits
from chona_model.render.occupancy import whole_support
from chona_model.render.posed import depth_spans
from chona_model.render.tracing import PoseTable, TraceSettings, make_pose_table, trace
from chona_model.settings import RenderSettings
from chona_model.skeleton import Skeleton

CHUNK = 16384
"""Rays traced at once: enough to fill the kernels, little enough to stay in the caches."""


class GridActor:
    """A trained ``GridModel`` and how to look at it."""

    kind = "grid"

    def __init__(self, model: GridModel) -> None:
        self.model = model.eval()
        self.skeleton: Skeleton = model.skeleton
        self.persons: Mapping[str, Person] = {person.name: person for person in model.persons}
        self.objects: Mapping[str, ObjectShape] = {thing.name: thing for thing in model.objects}
        self.object_distance = model.object_distance

    def render(self, pose: Pose, camera: Camera, settings: RenderSettings) -> Picture:
        """Renders a view.

        Raises:
            KeyError: the pose names an identity the model does not know.
        """
        if settings.resolution < 1.0:
            return enlarge(self._render(pose, camera.scaled(settings.resolution), settings), camera)
        return self._render(pose, camera, settings)

    def _render(self, pose: Pose, camera: Camera, settings: RenderSettings) -> Picture:
        posed = self.model.posed(pose)
        occupancy = self.model.occupancy if settings.occupancy else whole_support(self.model.occupancy)
        table = make_pose_table(self.model, [posed], occupancy)
        near, far = depth_spans(table.parts[0], posed.figure, camera)
        rows, columns = np.nonzero(far > near)
        if len(rows) == 0:
            return empty_picture(camera)
        sums, failed, tried = self._trace(posed, table, camera, (rows, columns), (near, far), settings)
        return _picture(camera, rows, columns, sums / settings.supersampling**2, failed, tried)

    def _trace(
        self, posed: PosedFigure, table: PoseTable, camera: Camera, pixels: tuple[np.ndarray, np.ndarray],
        spans: tuple[np.ndarray, np.ndarray], settings: RenderSettings,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        model, (rows, columns) = self.model, pixels
        near, far = spans[0][rows, columns], spans[1][rows, columns]
        sums = np.zeros((len(rows), 6), dtype=np.float32)
        failed, tried = np.zeros(len(rows)), np.zeros(len(rows))
        limits = TraceSettings(
            step=settings.step, newton=NewtonLimits(steps=settings.newton_steps), trust=settings.trust,
            stop=settings.stop,
        )  # fmt: skip
        thing = posed.objects[0] if posed.objects else -1
        pairs = torch.tensor([[posed.person, thing]])
        with torch.inference_mode():
            matrices, index = model.matrices([posed], settings.offset)
            codes = torch.as_tensor(posed.code[None], dtype=torch.float32) if settings.shading else None
            for sub in range(settings.supersampling**2):
                shift = (np.array([sub % settings.supersampling, sub // settings.supersampling]) + 0.5) / (
                    settings.supersampling
                )
                for begin in range(0, len(rows), CHUNK):
                    part = slice(begin, begin + CHUNK)
                    places = np.stack([columns[part], rows[part]], axis=-1) + shift
                    origins, directions = (
                        np.ascontiguousarray(array, dtype=np.float32) for array in posed.figure.rays(camera, places)
                    )
                    count = len(origins)
                    traced = trace(
                        model, table, matrices, index, np.zeros(1, dtype=np.int32),
                        (origins, directions, near[part], far[part]), np.zeros(count, dtype=np.int32),
                        np.full(count, 0.5, dtype=np.float32), pairs, torch.zeros(count, dtype=torch.int64), codes,
                        limits,
                    )  # fmt: skip
                    sums[part] += traced.out.numpy()
                    failed[part] += traced.failed
                    tried[part] += traced.tried
        return sums, failed, tried

    def tensors(self) -> dict[str, Tensor]:
        """Parameters by identity, so that a scene reads only those it shows; and what frames them."""
        model = self.model
        result: dict[str, Tensor] = {}
        for name, value in model.field.state_dict().items():
            if name not in {"table", "lower", "person_codes", "object_codes"}:
                result[f"field.{name}"] = value
        for part, identity in enumerate(self._identities()):
            result[f"{identity}.table"] = model.field.table[part].detach()
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
        object_distance: float, shape: dict[str, Any], tensors: Mapping[str, Tensor],
    ) -> GridActor:  # fmt: skip
        """Inverse of ``shape`` and ``tensors``."""
        sizes = GridModelShape(**{**shape["sizes"], "field": GridShape(**shape["sizes"]["field"])})
        grids = [
            NodeGrid(
                np.array(values["origin"]), sizes.node_cell, np.array(values["dims"]),
                tensors[f"person.{name}.nodes"].numpy(), tensors[f"person.{name}.points"].numpy(),
            )
            for name, values in zip(persons, shape["grids"], strict=True)
        ]  # fmt: skip
        boxes = tuple(np.array([part[corner] for part in shape["parts"]]) for corner in ("lower", "upper"))
        model = GridModel(skeleton, persons, objects, object_distance, sizes, grids, (boxes[0], boxes[1]))
        actor = cls(model)
        with torch.no_grad():
            for part, identity in enumerate(actor._identities()):
                model.field.table[part] = tensors[f"{identity}.table"]
                begin, end = model.occupancy.first[part], model.occupancy.first[part + 1]
                model.occupancy.densities[begin:end] = tensors[f"{identity}.density"].numpy()
                model.occupancy.support[begin:end] = tensors[f"{identity}.support"].numpy()
            own = {name[6:]: value for name, value in tensors.items() if name.startswith("field.")}
            model.field.load_state_dict(own, strict=False)
            model.field.person_codes.copy_(tensors["codes.persons"])
            model.field.object_codes.copy_(tensors["codes.objects"])
            for index, name in enumerate(persons):
                prefix = f"person.{name}.skin."
                skin = {key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)}
                model.volumes[index].load_state_dict(skin)
        return actor


def _picture(
    camera: Camera, rows: np.ndarray, columns: np.ndarray, values: np.ndarray, failed: np.ndarray, tried: np.ndarray
) -> Picture:
    empty = empty_picture(camera)
    alpha = np.clip(values[:, 3], 0.0, 1.0)
    solid = alpha > 0
    depth = np.full(len(rows), EMPTY_DEPTH, dtype=np.float32)
    depth[solid] = values[solid, 4] / values[solid, 3]
    thing = np.clip(values[:, 5], 0.0, alpha)
    empty.rgb[rows, columns] = values[:, :3]
    empty.alpha[rows, columns] = alpha
    empty.depth[rows, columns] = depth
    empty.object[rows, columns] = thing
    empty.human[rows, columns] = alpha - thing
    empty.confidence[rows, columns] = 1.0 - failed / np.maximum(tried, 1.0)
    share = float(failed.sum() / max(tried.sum(), 1.0))
    return Picture(empty.rgb, empty.alpha, empty.depth, empty.human, empty.object, empty.confidence, len(rows), share)

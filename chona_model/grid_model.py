"""The default model: grids per identity, skinning in voxels, occupancy. The paper's method with named shortcuts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from chona_model.data.dataset import ObjectShape, Person, Pose
from chona_model.deform.voxels import NodeGrid, SkinningVolume, initial_weights, make_node_grid
from chona_model.field.grid import GridField, GridShape
from chona_model.field.light import root_light
from chona_model.figure import Figure, Rig, make_figure, pose_code_size, pose_codes
from chona_model.kernels.cpu import skinning
from chona_model.kernels.warp import VolumeIndex
from chona_model.render.occupancy import Occupancy, PartCells, make_occupancy, part_cells
from chona_model.render.posed import STARTS, PosedPart, pose_cells, slot_matrices
from chona_model.skeleton import Skeleton

BODY_MARGIN = 0.25
"""The canonical box of a person reaches this far beyond its joints, metres (head, hands, hair, hats)."""

SURFACE_MARGIN = 0.12
"""The same beyond a body model's surface, which has hands and a head: clothes, hair and shoes, metres."""

OBJECT_MARGIN = 0.04
"""The box of an object reaches this far beyond its given extent, metres."""


@dataclass(frozen=True)
class GridModelShape:
    """Sizes of a grid model besides its field's.

    Attributes:
        field: the radiance field.
        node_cell: spacing of the skinning nodes, metres; node_reach: nodes this near the bones are active, metres.
        occupancy_cell: metres.
        offset_rank: shapes in the offset's basis; 0 for none.
        object_slots: objects a pose may have.
        turns_objects: whether pseudo bones turn, or only move (see ``methods.py``).
        reach: metres beyond a person's own box that its canonical space has for what it holds.
    """

    field: GridShape = GridShape()
    node_cell: float = 0.03
    node_reach: float = 0.22
    occupancy_cell: float = 0.015
    offset_rank: int = 4
    object_slots: int = 1
    turns_objects: bool = True
    reach: float = 0.0

    def __post_init__(self) -> None:
        cells = all(1e-4 <= cell <= 10.0 for cell in (self.node_cell, self.node_reach, self.occupancy_cell))
        if not (cells and 0 <= self.offset_rank <= 256 and 0 <= self.object_slots <= 64 and 0.0 <= self.reach <= 100.0):
            raise ValueError(f"sizes of a grid model out of range: {self}")


@dataclass(frozen=True)
class PosedFigure:
    """A pose made ready: root-space transforms and identity indices (−1 = absent)."""

    figure: Figure
    person: int
    objects: tuple[int, ...]
    code: np.ndarray
    slots: np.ndarray


class GridModel(nn.Module):
    """Persons and objects learned together.

    Args:
        skeleton: of all persons; persons, objects: identities by name, in the order of their indices.
        object_distance: canonical distance of objects, metres.
        shape: sizes.
        grids: skinning nodes of the persons where they come from a file, None for those to be made.
        boxes: of the parts, where they come from a file.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        persons: Mapping[str, Person],
        objects: Mapping[str, ObjectShape],
        object_distance: float,
        shape: GridModelShape,
        grids: Sequence[NodeGrid | None] | None = None,
        boxes: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        super().__init__()
        self.skeleton, self.shape, self.object_distance = skeleton, shape, object_distance
        self.persons, self.objects = tuple(persons.values()), tuple(objects.values())
        self.boxes = boxes or part_boxes(skeleton, self.persons, self.objects, shape.reach)
        lower, upper = self.boxes
        slots = shape.object_slots
        self.code_size = pose_code_size(len(skeleton), slots)
        self.field = GridField(shape.field, lower, upper, len(self.persons), self.code_size)
        self.occupancy: Occupancy = make_occupancy(lower, upper, shape.occupancy_cell)
        volumes = []
        for index, person in enumerate(self.persons):
            tails = skeleton.bone_tails(person.rest_joints)
            given = None if grids is None else grids[index]
            grid = given or make_node_grid(
                lower[index], upper[index], shape.node_cell, person.rest_joints, tails, shape.node_reach,
                person.surface,
            )  # fmt: skip
            volume = SkinningVolume(grid, len(skeleton), self.code_size, shape.offset_rank)
            if given is None:
                volume.initialise(initial_weights(grid.points, person.rest_joints, tails, person.surface))
            volumes.append(volume)
        self.volumes = nn.ModuleList(volumes)

    def volume(self, person: int) -> SkinningVolume:
        """Skinning of a person."""
        volume = self.volumes[person]
        assert isinstance(volume, SkinningVolume)
        return volume

    def grid(self, person: int) -> NodeGrid:
        """Skinning nodes of a person."""
        return self.volume(person).grid

    def rig(self, person: int) -> Rig:
        """The rig of a person; of no person (−1), one with joints at the origin, for objects alone."""
        joints = self.persons[person].rest_joints if person >= 0 else np.zeros((len(self.skeleton), 3))
        return Rig(self.skeleton, joints, self.object_distance, self.shape.turns_objects, self.shape.reach)

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return self.field.lower.device

    def real(self, array: np.ndarray) -> Tensor:
        """An array on the model's device, in its floating type."""
        return torch.as_tensor(array, dtype=self.field.lower.dtype, device=self.device)

    def slot_parts(self, pose: PosedFigure) -> np.ndarray:
        """[N] int32 which part each object slot of a pose shows, −1 for none."""
        parts = np.full(self.shape.object_slots, -1, dtype=np.int32)
        parts[: len(pose.objects)] = [len(self.persons) + thing for thing in pose.objects]
        return parts

    def person_index(self, name: str | None) -> int:
        """Index of a person by name; −1 for None.

        Raises:
            KeyError: with the names there are.
        """
        return -1 if name is None else _index("person", name, [person.name for person in self.persons])

    def object_index(self, name: str) -> int:
        """Index of an object by name among the objects."""
        return _index("object", name, [thing.name for thing in self.objects])

    def posed(self, pose: Pose) -> PosedFigure:
        """Moves a pose into root space and looks its identities up."""
        person = self.person_index(pose.person)
        rig = self.rig(person)
        figure = make_figure(
            rig, pose.world_from_bone if person >= 0 else None, pose.world_from_object, self.shape.object_slots
        )
        objects = tuple(self.object_index(name) for name in pose.objects)
        slots = slot_matrices(figure, len(self.skeleton), rig.canonical_objects(self.shape.object_slots))
        return PosedFigure(figure, person, objects, pose_codes([figure], rig)[0], slots)

    def pairs(self, pose: PosedFigure) -> Tensor:
        """[1 + N, 2] int64 identities (person, object; −1 for none) on whose codes the person is conditioned, and each
        object."""
        body = self.pair(pose.person, next(iter(pose.objects), -1), of_object=False)
        return torch.tensor([body, *(self.pair(pose.person, thing, of_object=True) for thing in pose.objects)])

    def pair(self, person: int, thing: int, *, of_object: bool) -> tuple[int, int]:
        """Indices (−1 = none) of the person and the object on whose codes a part is conditioned."""
        if not self.shape.field.own_codes:
            return person, thing
        return (-1, thing) if of_object else (person, -1)

    def matrices(self, poses: Sequence[PosedFigure], offset: bool = True) -> tuple[Tensor, VolumeIndex]:
        """Blended matrices of every pose, [rows, 16], and where each pose's rows are; differentiable."""
        rows: list[Tensor | None] = [None] * len(poses)
        bones = len(self.skeleton)
        for person in sorted({pose.person for pose in poses if pose.person >= 0}):
            mine = [index for index, pose in enumerate(poses) if pose.person == person]
            transforms = self.real(np.stack([poses[index].figure.transforms[:bones] for index in mine]))
            codes = self.real(np.stack([poses[index].code for index in mine]))
            blended = self.volume(person).blend(transforms, codes if offset else None)
            for index, matrix in zip(mine, blended, strict=True):
                rows[index] = matrix
        lengths = [0 if row is None else len(row) for row in rows]
        present = [row for row in rows if row is not None]
        matrices = torch.cat(present) if present else self.real(np.zeros((1, 16)))
        return matrices, self._index(poses, np.concatenate([[0], np.cumsum(lengths)])[:-1])

    def rendering_matrices(self, pose: PosedFigure, offset: bool = True) -> Tensor:
        """Blended matrices of one pose [M, 16] without gradients, from weights that are kept; see ``blend_padded``."""
        if pose.person < 0:
            return self.real(np.zeros((1, 16)))
        codes = self.real(pose.code[None]) if offset else None
        transforms = self.real(pose.figure.transforms[: len(self.skeleton)])
        return self.volume(pose.person).blend_padded(transforms, codes)

    def root_light(self, poses: Sequence[PosedFigure]) -> Tensor:
        """The light [P, 9, 3] in the root space of each pose; differentiable."""
        return root_light(self.field.light, np.stack([pose.figure.root_from_world[:3, :3] for pose in poses]))

    def _index(self, poses: Sequence[PosedFigure], first_row: np.ndarray) -> VolumeIndex:
        grids = [self.grid(index) for index in range(len(self.persons))]
        begin = np.concatenate([[0], np.cumsum([len(grid.nodes) for grid in grids])])
        persons = [max(pose.person, 0) for pose in poses]
        if not grids:
            empty = np.zeros((len(poses), 3))
            return VolumeIndex(
                np.zeros(1, np.int32), np.zeros(len(poses), np.int64), empty.astype(np.int64) + 2,
                empty.astype(np.float32), first_row.astype(np.int64), 1.0,
            )  # fmt: skip
        return VolumeIndex(
            nodes=np.concatenate([grid.nodes for grid in grids]) if len(grids) > 1 else grids[0].nodes,
            first_node=begin[persons].astype(np.int64),
            dims=np.stack([grids[person].dims for person in persons]),
            origins=np.stack([grids[person].origin for person in persons]).astype(np.float32),
            first_row=first_row.astype(np.int64),
            inverse_cell=1.0 / self.shape.node_cell,
        )

    def cells(self, occupancy: Occupancy) -> list[PartCells]:
        """Occupied cells of every part."""
        return [part_cells(occupancy, part) for part in range(len(occupancy.dims))]

    def pose_cells(
        self, pose: PosedFigure, cells: Sequence[PartCells], matrices: np.ndarray | None = None, chances: int = STARTS
    ) -> PosedPart:
        """Posed start grid and bounding points of one pose.

        Args:
            cells: of every part; matrices: [M, 16] blended matrices of the pose, made here where not given.
            chances: starts kept a posed cell, 1 or 2.
        """
        posed = None
        if pose.person >= 0:
            posed = self.warp_points(pose, cells[pose.person].centres, matrices)
        objects = [
            (cells[len(self.persons) + index], pose.slots[slot].astype(np.float64))
            for slot, index in enumerate(pose.objects)
        ]
        person = cells[pose.person] if posed is not None else None
        return pose_cells(person, objects, posed, cells[0].cell, chances)

    def warp_points(self, pose: PosedFigure, points: np.ndarray, matrices: np.ndarray | None = None) -> np.ndarray:
        """Forward skinning of canonical points [K, 3] of the pose's person into root space, float32."""
        if matrices is None:
            with torch.no_grad():
                matrices = self.matrices([pose])[0].cpu().numpy()
        grid, matrices = self.grid(pose.person), np.asarray(matrices, dtype=np.float32)
        out = np.empty((len(points), 3), dtype=np.float32)
        skinning.forward(
            np.ascontiguousarray(points, dtype=np.float32), matrices, grid.nodes, grid.dims,
            grid.origin.astype(np.float32), np.float32(1.0 / grid.cell), out,
        )  # fmt: skip
        return out


def part_boxes(
    skeleton: Skeleton, persons: Sequence[Person], objects: Sequence[ObjectShape], reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners [I, 3] of the parts, persons first, each in its own frame, metres.

    Args:
        reach: metres beyond a person's own box for what it holds.
    """
    lower, upper = [], []
    for person in persons:
        points = [person.rest_joints, skeleton.bone_tails(person.rest_joints)]
        if person.surface is not None:
            points.append(person.surface.vertices)
        margin = (BODY_MARGIN if person.surface is None else SURFACE_MARGIN) + reach
        lower.append(np.concatenate(points).min(axis=0) - margin)
        upper.append(np.concatenate(points).max(axis=0) + margin)
    for thing in objects:
        lower.append(np.asarray(thing.lower) - OBJECT_MARGIN)
        upper.append(np.asarray(thing.upper) + OBJECT_MARGIN)
    return np.array(lower).reshape(-1, 3), np.array(upper).reshape(-1, 3)


def _index(kind: str, name: str, names: list[str]) -> int:
    if name not in names:
        raise KeyError(f"the model has no {kind} '{name}'; it has: {', '.join(names) or 'none'}")
    return names.index(name)

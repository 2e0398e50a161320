"""From a model file to the meshes of a person and objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chona_model.data.dataset import Pose
from chona_model.exact_actor import ExactActor
from chona_model.figure import Rig
from chona_model.formats.model_file import file_hash
from chona_model.grid_actor import GridActor
from chona_model.model_store import load_actor
from chona_model.progress import Progress
from chona_model.skeleton import translation
from chona_model.standin.attributes import colour_samples, colours, strongest
from chona_model.standin.exact_part import ExactPart
from chona_model.standin.file import PartMesh, StandIn, write_stand_in
from chona_model.standin.grid_part import GridPart
from chona_model.standin.part import Part
from chona_model.standin.surface import (
    EDGE,
    OPACITY,
    clean,
    fair,
    lattice_size,
    light_in,
    limited,
    measure,
    snap,
    snap_depths,
)

PERCENT = 100
MEASURED = 0.6
"""Share of a part's time that its lattice takes, for the bar."""

MOST_NODES = 400_000_000
"""A lattice of more nodes is refused: it would take gigabytes."""

UPRIGHT = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""World (z up) from canonical space (y up)."""


class StandInError(ValueError):
    """A stand-in that cannot be made: what was asked for, what is there, what to do."""


@dataclass(frozen=True)
class StandInSettings:
    """How fine a stand-in is.

    Attributes:
        voxel: metres between the nodes at which the field is asked.
        faces: triangles of each part at most; None for as many as the voxels give.
        edge: light that is left on the surface, along its normal; near 1 where outlines of soft fields count.
        smallest: floaters, pieces whose box has a shorter diagonal, are dropped; metres.
    """

    voxel: float = 0.01
    faces: int | None = None
    smallest: float = 0.06
    edge: float = EDGE


@dataclass(frozen=True)
class Report:
    """What was made: vertices and faces of all parts, floaters that were dropped."""

    parts: int
    vertices: int
    faces: int
    dropped: int

    def sentence(self) -> str:
        """For people."""
        floaters = f", {self.dropped} floater{'s' * (self.dropped > 1)} dropped" if self.dropped else ""
        return f"{self.parts} mesh{'es' * (self.parts > 1)}, {self.faces} triangles{floaters}"


def canonical_pose(rig: Rig, person: str | None, objects: Sequence[str]) -> Pose:
    """The canonical pose, stood upright in a world whose z is up."""
    bones = UPRIGHT @ translation(rig.rest_joints) if person is not None else np.zeros((0, 4, 4))
    return Pose(person, tuple(objects), bones, UPRIGHT @ translation(rig.canonical_objects(len(objects))))


def open_parts(
    model: Path, person: str | None, objects: Sequence[str], device: str
) -> tuple[list[Part], GridActor | ExactActor]:
    """The person and the objects of a model file as fields.

    Raises:
        ModelFileError: see ``load_actor``.  StandInError: more objects than the model can show together.
    """
    actor = load_actor(model, device, [] if person is None else [person], objects)
    assert isinstance(actor, GridActor | ExactActor)
    slots = actor.model.shape.object_slots
    if len(objects) > slots:
        raise StandInError(
            f"{len(objects)} objects are asked for, the model shows {slots} at once; make the stand-ins of the others "
            "with a command of their own"
        )
    wanted = [("person", person)] if person is not None else []
    wanted += [("object", name) for name in objects]
    joints = actor.persons[person].rest_joints if person is not None else np.zeros((len(actor.skeleton), 3))
    pose = canonical_pose(Rig(actor.skeleton, joints, actor.object_distance), person, objects)
    if isinstance(actor, GridActor):
        return [GridPart(actor.model, kind, name, pose) for kind, name in wanted], actor
    return [ExactPart(actor, kind, name, pose) for kind, name in wanted], actor


def make_stand_in(
    model: Path, person: str | None, objects: Sequence[str], out: Path, settings: StandInSettings, progress: Progress,
    device: str = "cpu",
) -> Report:  # fmt: skip
    """Makes the meshes and writes them to ``out``, whole or not at all.

    Raises:
        ModelFileError, StandInError: see ``open_parts``; also a part of which nothing is opaque, and voxels so small
            that memory would not hold them.  Cancelled: on request, with nothing written.
    """
    parts, actor = open_parts(model, person, tuple(dict.fromkeys(objects)), device)
    progress.check()
    nodes = [int(lattice_size(part, settings.voxel).prod()) for part in parts]
    if max(nodes) > MOST_NODES:
        raise StandInError(
            f"voxels of {settings.voxel:g} m make {max(nodes):,} nodes, {MOST_NODES:,} are possible; give a larger "
            "--voxel"
        )
    progress.start("stand-in", PERCENT, unit="%")
    meshes, floaters = [], 0
    for index, part in enumerate(parts):
        mesh, dropped = _mesh(part, settings, progress, (index, len(parts)), nodes[index])
        meshes.append(mesh)
        floaters += dropped
    joints = None if person is None else actor.persons[person].rest_joints
    write_stand_in(out, StandIn(actor.skeleton, joints, file_hash(model), settings.voxel, OPACITY, tuple(meshes)))
    progress.update(PERCENT)
    return Report(
        len(meshes), sum(len(mesh.vertices) for mesh in meshes), sum(len(mesh.faces) for mesh in meshes), floaters
    )


def _mesh(
    part: Part, settings: StandInSettings, progress: Progress, place: tuple[int, int], nodes: int
) -> tuple[PartMesh, int]:
    """A part's mesh and how many floaters were dropped; ``place`` is the part's number, from 0, and of how many."""
    done = [0.0]

    def tell(share: float, words: str) -> None:
        progress.check()
        progress.update(int(PERCENT * (place[0] + min(share, 0.999)) / place[1]), f"{part.name}: {words}")

    def asked(count: int) -> None:
        done[0] += count / nodes
        tell(MEASURED * done[0], "measuring")

    lattice, dropped = clean(light_in(measure(part, settings.voxel, asked)), settings.smallest)
    tell(MEASURED, "surface")
    used, surface = limited(lattice, settings.faces)
    if surface is None:
        raise StandInError(
            f"{part.kind} '{part.name}' is nowhere so opaque that voxels of {settings.voxel:g} m show it; train the "
            "model longer, or give a larger --voxel"
        )
    wanted = len(surface.vertices) * (colour_samples() + len(snap_depths()))
    done[0] = 0.0

    def coloured(count: int) -> None:
        done[0] += count / wanted
        tell(MEASURED + (1.0 - MEASURED) * done[0], "colours")

    surface = fair(snap(part, surface, settings.voxel, coloured, settings.edge))
    rgb = colours(part, surface.vertices, surface.normals, used.voxel, coloured)
    bones, weights = strongest(part.weights(surface.vertices)) if part.kind == "person" else (None, None)
    mesh = PartMesh(
        part.kind, part.name, surface.vertices.astype(np.float32), surface.faces.astype(np.int32),
        surface.normals.astype(np.float32), np.round(255.0 * rgb).astype(np.uint8), bones, weights,
    )  # fmt: skip
    return mesh, dropped

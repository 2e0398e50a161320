"""The surface of a part: as deep as light comes from outside before a quarter of a ray's way through is stopped.

A field has no surface of its own: walls may be centimetres thick and far from opaque in any one voxel, and what lies
behind them was never seen.  So a point counts as inside where, from none of 26 directions, enough light reaches it.
Cavities that no light reaches are solid, and whatever stops half of the light that passes through it is shown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy import ndimage
from skimage.measure import marching_cubes

from chona_model.standin.part import CHUNK, Part

OPACITY = 0.5
"""Whatever is this opaque as a whole, seen through from one side to the other, has a surface."""

LEVEL = float(np.sqrt(1.0 - OPACITY))
"""Light on the surface: in the middle of a sheet of just that opacity, where from either side as much arrives."""

BLUR = 0.7
"""Voxels over which light is averaged before the surface is taken: less than half of a voxel's noise is left, and walls
of two voxels still stand."""

EVERYWHERE = np.ones((3, 3, 3), dtype=bool)
"""Nodes that touch at a corner belong together."""

Step = Callable[[int], None]
"""Called with the number of points asked for since the last call; may raise to stop."""


@dataclass(frozen=True)
class Lattice:
    """Values at the nodes of a lattice: optical depths of a voxel's length, or light; nothing is along its border.

    Attributes:
        origin: [3] the first node; voxel: metres between nodes.
        values: [X, Y, Z] float32.
    """

    origin: np.ndarray
    voxel: float
    values: np.ndarray


@dataclass(frozen=True)
class Surface:
    """A closed triangle mesh.

    Attributes:
        vertices: [V, 3] float64 metres; faces: [F, 3] int64, counter-clockwise seen from outside.
        normals: [V, 3] unit length, outwards.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray


def lattice_size(part: Part, voxel: float) -> np.ndarray:
    """[3] nodes along each axis, with two beyond either end of the part's box."""
    return np.ceil((part.upper - part.lower) / voxel).astype(np.int64) + 5


def measure(part: Part, voxel: float, step: Step) -> Lattice:
    """Optical depths of a voxel's length, wherever the model renders anything; ``step`` is told of every node."""
    size = lattice_size(part, voxel)
    origin = 0.5 * (part.lower + part.upper) - 0.5 * voxel * (size - 1)
    depths = np.zeros(size.prod(), dtype=np.float32)
    for begin in range(0, len(depths), CHUNK):
        nodes = np.arange(begin, min(begin + CHUNK, len(depths)))
        points = origin + voxel * np.stack(np.unravel_index(nodes, size), axis=-1)
        held = np.flatnonzero(part.holds(points))
        if len(held):
            depths[nodes[held]] = part.density(points[held], voxel) * np.float32(voxel)
        step(len(nodes))
    inner = np.pad(depths.reshape(size)[1:-1, 1:-1, 1:-1], 1)
    return Lattice(origin, voxel, inner)


def light_in(depths: Lattice) -> Lattice:
    """Light that reaches every node: of the 26 directions to a node's neighbours, along the clearest; 0…1."""
    clearest = np.full(depths.values.shape, np.inf, dtype=np.float32)
    for direction in product((-1, 0, 1), repeat=3):
        if any(direction):
            _keep_clearest(clearest, depths.values, direction)
    return replace(depths, values=np.exp(-clearest))


def _keep_clearest(clearest: np.ndarray, depths: np.ndarray, direction: tuple[int, ...]) -> None:
    """Takes the optical depth of the way that light came along ``direction`` where it is the least; in place."""
    axis = next(index for index, sign in enumerate(direction) if sign)
    found, own = np.moveaxis(clearest, axis, 0), np.moveaxis(depths, axis, 0)
    aside = [sign for index, sign in enumerate(direction) if index != axis]
    length = np.float32(np.linalg.norm(direction))
    order = range(len(own)) if direction[axis] > 0 else range(len(own) - 1, -1, -1)
    way = before = np.zeros_like(own[0])
    for index in order:
        way = _shifted(way, aside) + 0.5 * length * (_shifted(before, aside) + own[index])
        before = own[index]
        np.minimum(found[index], way, out=found[index])


def _shifted(plane: np.ndarray, aside: list[int]) -> np.ndarray:
    """A plane [Y, Z] moved by −1, 0 or 1 along each axis, with zeros where nothing was."""
    into, out = [], []
    for shift in aside:
        into.append(slice(max(shift, 0), min(shift, 0) or None))
        out.append(slice(max(-shift, 0), min(-shift, 0) or None))
    moved = np.zeros_like(plane)
    moved[tuple(into)] = plane[tuple(out)]
    return moved


def clean(light: Lattice, smallest: float) -> tuple[Lattice, int]:
    """Smooths, darkens what is closed off, and drops floaters: pieces whose box has a diagonal below ``smallest``.

    Every other piece stays, however many there are; of pieces that are all smaller, the largest.

    Returns:
        the light, and how many pieces were dropped.
    """
    smooth = ndimage.gaussian_filter(light.values, BLUR)
    closed = ndimage.binary_fill_holes(smooth < LEVEL) & (smooth >= LEVEL)
    smooth = np.where(closed, np.float32(0.0), smooth)
    pieces, _ = ndimage.label(smooth < LEVEL, EVERYWHERE)
    boxes = ndimage.find_objects(pieces)
    lengths = [light.voxel * np.linalg.norm([side.stop - side.start for side in box]) for box in boxes]
    dropped = [
        index + 1 for index, length in enumerate(lengths) if length < smallest and index != int(np.argmax(lengths))
    ]
    smooth = np.where(np.isin(pieces, dropped), np.float32(1.0), smooth)
    return replace(light, values=smooth), len(dropped)


def coarser(light: Lattice, factor: float) -> Lattice:
    """The same light on a lattice of ``factor`` (above 1) times its spacing, averaged so that nothing flickers."""
    smooth = ndimage.gaussian_filter(light.values, 0.5 * np.sqrt(factor**2 - 1.0), mode="nearest")
    old = np.array(smooth.shape)
    size = np.ceil((old - 1) / factor).astype(np.int64) + 3
    start = 0.5 * (old - 1) - 0.5 * factor * (size - 1)
    places = np.meshgrid(
        *(at + factor * np.arange(count) for at, count in zip(start, size, strict=True)), indexing="ij"
    )
    values = ndimage.map_coordinates(smooth, places, order=1, mode="constant", cval=1.0)
    return Lattice(light.origin + light.voxel * start, light.voxel * factor, values.astype(np.float32))


def extract(light: Lattice) -> Surface | None:
    """The closed surface by marching cubes; None where no node is dark."""
    if not (light.values < LEVEL).any():
        return None
    vertices, faces, _, _ = marching_cubes(
        light.values, LEVEL, spacing=(light.voxel,) * 3, gradient_direction="descent", allow_degenerate=False
    )
    vertices = vertices.astype(np.float64) + light.origin
    return Surface(vertices, faces.astype(np.int64), vertex_normals(vertices, faces))


def limited(light: Lattice, faces: int | None) -> tuple[Lattice, Surface | None]:
    """The surface of at most ``faces`` triangles (None: any number), from a lattice as much coarser as that takes."""
    surface, used = extract(light), light
    while surface is not None and faces is not None and len(surface.faces) > faces:
        used = coarser(light, used.voxel / light.voxel * max(np.sqrt(len(surface.faces) / faces), 1.02))
        surface = extract(used)
    return used, surface


EDGE = 0.95
"""Light along a surface's normal where an outline has it: a ray that glances off a limb goes some fourteen times as far
through its outermost millimetres as one that comes straight, and is half stopped there.  Hard walls do not care."""

SNAP, OUT, AHEAD, SNAP_STEP = 1.0, 2.0, 3.0, 0.25
"""How far vertices may be moved inwards and outwards, from how far outside light is followed, and between samples on
the way; in voxels."""

AVERAGED = 4
"""How often shifts are averaged over the vertices around each."""


def snap(part: Part, surface: Surface, voxel: float, step: Step, edge: float = EDGE) -> Surface:
    """Moves vertices along their normals to where the field itself, between the nodes, leaves ``edge`` of the light.

    A lattice knows the place of a hard wall to a third of a voxel.  Neighbours move alike: a field's own grain is no
    relief.
    """
    depths = snap_depths() * voxel
    shifts = np.zeros(len(surface.vertices))
    at_once = max(CHUNK // len(depths), 1)
    for begin in range(0, len(shifts), at_once):
        rows = slice(begin, begin + at_once)
        points = surface.vertices[rows, None] - depths[:, None] * surface.normals[rows, None]
        flat = points.reshape(-1, 3)
        density = np.where(part.holds(flat), part.density(flat, SNAP_STEP * voxel), 0.0).reshape(-1, len(depths))
        found = _depth_of_edge(density, depths, edge)
        # What stops light earlier is something else in front: there the lattice knows better.
        shifts[rows] = np.where(found < -OUT * voxel, 0.0, found)
        step(density.size)
    for _ in range(AVERAGED):
        shifts = _around(shifts, surface.faces)
    moved = surface.vertices - shifts[:, None] * surface.normals
    return Surface(moved, surface.faces, vertex_normals(moved, surface.faces))


FAIRING = (0.6, -0.63)
"""Taubin's two steps: a mean over vertices around takes the grain away, a longer step back keeps the volume."""

FAIRED = 8
"""How often both are taken: bumps of three voxels keep a quarter of their height, of eight nine tenths, limbs all."""


def fair(surface: Surface) -> Surface:
    """A field's grain smoothed away (Taubin, A signal processing approach to fair surface design, 1995)."""
    vertices = surface.vertices
    for share in FAIRING * FAIRED:
        mean = np.stack([_around(vertices[:, axis], surface.faces) for axis in range(3)], axis=-1)
        vertices = vertices + share * (mean - vertices)
    return Surface(vertices, surface.faces, vertex_normals(vertices, surface.faces))


def snap_depths() -> np.ndarray:
    """Where ``snap`` asks the field, in voxels below the surface."""
    return np.arange(-AHEAD, SNAP + SNAP_STEP / 2, SNAP_STEP)


def _depth_of_edge(density: np.ndarray, depths: np.ndarray, edge: float) -> np.ndarray:
    """[V] where rays that meet ``density`` [V, S] at ``depths`` [S] keep ``edge`` of their light; the last depth where
    they keep more."""
    step = depths[1] - depths[0]
    # Every sample stands for half a step before and behind it: a hard wall between two is found in their middle.
    stopped = np.cumsum(density, axis=1) * step
    wanted = -np.log(edge)
    index = np.argmax(stopped >= wanted, axis=1)
    row = np.arange(len(density))
    gain = np.maximum(density[row, index] * step, np.finfo(np.float64).tiny)
    found = depths[index] + step * (0.5 - (stopped[row, index] - wanted) / gain)
    return np.where(stopped[:, -1] >= wanted, found, depths[-1])


def _around(values: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """[V] means over every vertex's triangles, in which the vertex itself counts as often as its neighbours."""
    sums = np.bincount(faces.ravel(), np.repeat(values[faces].mean(axis=1), 3), len(values))
    return sums / np.maximum(np.bincount(faces.ravel(), minlength=len(values)), 1)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """[V, 3] unit normals, averages of the faces' weighted by their areas."""
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.stack(
        [np.bincount(faces.ravel(), np.repeat(areas[:, axis], 3), len(vertices)) for axis in range(3)], axis=-1
    )
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), np.finfo(np.float64).tiny)

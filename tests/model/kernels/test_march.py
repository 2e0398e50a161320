"""Marching: fast kernels, torch twins and plain loops agree; spans and pruning never lose anything that shows."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch

from chona_model.kernels import marching, reference
from chona_model.kernels.marching import BODY, Candidates, Occupancy, Slots, StartGrids

Scene = tuple[StartGrids[Any], Slots[Any], Occupancy[Any]]
STEP = np.float32(0.02)
CPU = torch.device("cpu")


def tensors(value: Any) -> Any:
    """An array, or a group of arrays, as float32 tensors for the twins."""
    return torch.from_numpy(value) if isinstance(value, np.ndarray) else marching._tensors(value, CPU)


def make_occupancy(generator: np.random.Generator, parts: int = 3, filled: float = 0.4) -> Occupancy[Any]:
    """Random densities in grids of random sizes around each part's origin."""
    dims = generator.integers(6, 12, (parts, 3))
    sizes = dims.prod(axis=1)
    density = np.where(generator.random(sizes.sum()) < filled, generator.random(sizes.sum()) * 50, 0)
    first = np.concatenate([[0], np.cumsum(sizes)])[:-1]
    return Occupancy(density.astype(np.float32), first, dims, np.full((parts, 3), -0.4, dtype=np.float32), 10.0)


def make_scene(seed: int, poses: int = 3, slots: int = 2) -> Scene:
    """Poses with random start grids, and objects in some of their slots."""
    generator = np.random.default_rng(seed)
    dims = generator.integers(8, 14, (poses, 3))
    sizes = dims.prod(axis=1)
    voxels = generator.integers(0, 999, (sizes.sum(), 2))
    starts = np.where(generator.random(voxels.shape) < 0.3, voxels, -1).astype(np.int32)
    origins = generator.uniform(-0.7, -0.5, (poses, 3)).astype(np.float32)
    first = np.concatenate([[0], np.cumsum(sizes)])[:-1]
    matrix = np.eye(3, 4) + generator.normal(0, 0.1, (poses, slots, 3, 4))
    part = generator.integers(-1, 3, (poses, slots)).astype(np.int32)
    return (
        StartGrids(starts, first, dims, origins, 10.0),
        Slots(part, matrix.astype(np.float32)),
        make_occupancy(generator),
    )


def make_rays(seed: int, rays: int = 60, poses: int = 3) -> tuple[np.ndarray, ...]:
    """Origins, directions, near, far, jitter, pose; every eighth ray misses."""
    generator = np.random.default_rng(seed + 50)
    origins = generator.normal(0, 0.1, (rays, 3)) - [0, 0, 2]
    directions = np.concatenate([generator.normal(0, 0.15, (rays, 2)), np.ones((rays, 1))], axis=1)
    near = generator.uniform(1.0, 1.8, rays)
    far = near + generator.uniform(0.0, 1.5, rays)
    near[::8], far[::8] = np.inf, 0.0
    numbers = (origins, directions, near, far, generator.random(rays))
    return *(a.astype(np.float32) for a in numbers), generator.integers(0, poses, rays).astype(np.int32)


def cell_of(point: np.ndarray, origin: np.ndarray, inverse_cell: float, dims: np.ndarray) -> int | None:
    """Index of the cell that holds a point, in float32 as the kernels compute it."""
    place = (point - origin) * np.float32(inverse_cell)
    if (place < 0).any() or (place.astype(int) >= dims).any():
        return None
    x, y, z = place.astype(int)
    return int(x + dims[0] * (y + dims[1] * z))


def march_by_loop(rays: tuple[np.ndarray, ...], scene: Scene) -> list[list[tuple[float, int, int, np.ndarray]]]:
    """(depth, kind, voxel, point) of every candidate of every ray."""
    grids, slots, occupancy = scene
    found: list[list[tuple[float, int, int, np.ndarray]]] = []
    for origin, direction, near, far, jitter, pose in zip(*rays, strict=True):
        here: list[tuple[float, int, int, np.ndarray]] = []
        squares = direction * direction
        dt = STEP / np.sqrt(squares[0] + squares[1] + squares[2])
        begin = near + jitter * dt
        number = 0
        while (depth := begin + np.float32(number) * dt) < far:
            number += 1
            point = origin + depth * direction
            cell = cell_of(point, grids.origins[pose], grids.inverse_cell, grids.dims[pose])
            for start in [] if cell is None else grids.starts[grids.first[pose] + cell]:
                if start < 0:
                    break
                here.append((depth, BODY, start, point))
            for slot, part in enumerate(slots.part[pose]):
                if part < 0:
                    continue
                m = slots.matrix[pose, slot]
                local = m[:, 0] * point[0] + m[:, 1] * point[1] + m[:, 2] * point[2] + m[:, 3]
                cell = cell_of(local, occupancy.origins[part], occupancy.inverse_cell, occupancy.dims[part])
                if cell is not None and occupancy.densities[occupancy.first[part] + cell] > 0:
                    here.append((depth, slot, -1, local))
        found.append(here)
    return found


def assert_same(found: Candidates[Any], other: Candidates[Any]) -> None:
    """Bit-identical and of the same types."""
    for field in fields(found):
        a, b = (np.asarray(getattr(c, field.name)) for c in (found, other))
        assert a.dtype == b.dtype, field.name
        np.testing.assert_array_equal(a, b, err_msg=field.name)


@pytest.mark.parametrize("seed", range(3))
def test_candidates_equal_a_plain_loop(seed: int) -> None:
    rays, scene = make_rays(seed), make_scene(seed)
    found = marching.march(*rays, STEP, *scene)
    expected = march_by_loop(rays, scene)
    np.testing.assert_array_equal(np.diff(found.first), [len(here) for here in expected])
    assert {-1, 0, 1} == set(found.kind.tolist())
    rows = [(ray, *row) for ray, here in enumerate(expected) for row in here]
    for values, column in zip((found.ray, found.depth, found.kind, found.voxel), zip(*rows, strict=True), strict=False):
        np.testing.assert_array_equal(values, np.array(column))
    np.testing.assert_array_equal(found.points, np.stack([row[-1] for row in rows]))


@pytest.mark.parametrize("seed", range(3))
def test_march_equals_the_twin(seed: int) -> None:
    rays, scene = make_rays(seed, rays=500), make_scene(seed)
    found = marching.march(*rays, STEP, *scene)
    twin = reference.march(*(tensors(a) for a in rays), STEP, *(tensors(g) for g in scene))
    assert_same(found, twin)
    assert isinstance(found.points, np.ndarray)


def test_tensors_in_tensors_out() -> None:
    rays, scene = make_rays(0), make_scene(0)
    found = marching.march(*(tensors(a) for a in rays), STEP, *(tensors(g) for g in scene))
    assert all(isinstance(getattr(found, field.name), torch.Tensor) for field in fields(found))
    assert_same(found, marching.march(*rays, STEP, *scene))


def test_other_dtypes_take_the_twin() -> None:
    rays, scene = make_rays(0), make_scene(0)
    wide = [tensors(a).double() if a.dtype == np.float32 else tensors(a) for a in rays]
    found = marching.march(*wide, float(STEP), *scene)
    narrow = marching.march(*rays, STEP, *scene)
    assert found.points.dtype == torch.float64
    assert abs(len(found.ray) - len(narrow.ray)) < 0.01 * len(narrow.ray)


def test_no_objects_and_no_rays() -> None:
    grids, slots, occupancy = make_scene(1)
    none = Slots(slots.part[:, :0], slots.matrix[:, :0])
    rays = make_rays(1)
    scene = grids, none, occupancy
    found = marching.march(*rays, STEP, *scene)
    assert set(found.kind.tolist()) == {BODY}
    assert_same(found, reference.march(*(tensors(a) for a in rays), STEP, *(tensors(g) for g in scene)))
    rays = tuple(a[:0] for a in rays)
    found = marching.march(*rays, STEP, *make_scene(1))
    assert found.first.tolist() == [0] and found.points.shape == (0, 3)
    assert_same(found, reference.march(*(tensors(a) for a in rays), STEP, *(tensors(g) for g in make_scene(1))))


def test_repeats_are_identical() -> None:
    rays, scene = make_rays(2, rays=500), make_scene(2)
    assert_same(marching.march(*rays, STEP, *scene), marching.march(*rays, STEP, *scene))


# Posed start grids


def make_voxels(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Posed and canonical centres, origin and dims; some voxels lie outside the grid."""
    generator = np.random.default_rng(seed)
    posed = generator.uniform(-0.1, 0.7, (150, 3)).astype(np.float32)
    canonical = (posed + generator.normal(0, 0.1, posed.shape)).astype(np.float32)
    return posed, canonical, np.array([0.0, 0.05, 0.1], dtype=np.float32), np.array([11, 13, 9])


@pytest.mark.parametrize("seed", range(3))
def test_starts_equal_a_plain_search(seed: int) -> None:
    posed, canonical, origin, dims = make_voxels(seed)
    cell, reach, apart = 0.05, 0.06, 0.08
    starts = marching.mark_starts(posed, canonical, origin, 1 / cell, dims, reach, apart)
    z, y, x = np.meshgrid(*(np.arange(n) for n in dims[::-1]), indexing="ij")
    centres = origin + (np.stack([x, y, z], axis=-1).reshape(-1, 3) + 0.5) * cell
    gaps = np.abs(posed[:, None].astype(float) - centres)
    box = np.linalg.norm(np.maximum(gaps - cell / 2, 0), axis=2)
    distances = np.linalg.norm(gaps, axis=2)
    assert (starts[:, 0] >= 0).any() and (starts[:, 0] < 0).any() and (starts[:, 1] >= 0).any()
    for index, (first, second) in enumerate(starts):
        near = np.flatnonzero(box[:, index] <= reach)
        if not len(near):
            assert first == -1 and second == -1
            continue
        assert first == near[np.argmin(distances[near, index])]
        other = near[np.linalg.norm(canonical[near] - canonical[first], axis=1) > apart]
        assert second == (other[np.argmin(distances[other, index])] if len(other) else -1)


@pytest.mark.parametrize("chances", [1, 2])
def test_starts_equal_the_twin(chances: int) -> None:
    posed, canonical, origin, dims = make_voxels(5)
    arguments = (20.0, dims, 0.06, 0.08, chances)
    found = marching.mark_starts(posed, canonical, origin, *arguments)
    twin = reference.mark_starts(*(tensors(a) for a in (posed, canonical, origin)), 20.0, tensors(dims), *arguments[2:])
    assert found.shape == (dims.prod(), chances)
    np.testing.assert_array_equal(found, twin)
    np.testing.assert_array_equal(found, marching.mark_starts(posed, canonical, origin, *arguments))


def test_no_voxels() -> None:
    _, _, origin, dims = make_voxels(0)
    none = np.zeros((0, 3), dtype=np.float32)
    assert (marching.mark_starts(none, none, origin, 20.0, dims, 0.06, 0.08) == -1).all()
    twin = reference.mark_starts(*(tensors(a) for a in (none, none, origin)), 20.0, tensors(dims), 0.06, 0.08, 2)
    assert (twin == -1).all()


# Depth spans

HEIGHT, WIDTH = 40, 56


def make_view(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points before, beside and behind a camera; camera_from_root; intrinsics with unequal focal lengths."""
    generator = np.random.default_rng(seed)
    points = generator.normal(0, 0.7, (40, 3)).astype(np.float32)
    turn, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    camera = np.concatenate([turn, [[0.1], [-0.05], [1.6]]], axis=1)
    return points, camera, np.array([[50.0, 0, 27.0], [0, 44.0, 21.0], [0, 0, 1]])


def spans(
    points: np.ndarray, camera: np.ndarray, pixels: np.ndarray, orthographic: bool, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Fresh spans of the points."""
    near = np.full((HEIGHT, WIDTH), np.inf, dtype=np.float32)
    far = np.zeros((HEIGHT, WIDTH), dtype=np.float32)
    marching.splat_spans(points, camera, pixels, orthographic, radius, near, far)
    return near, far


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("radius", [0.01, 0.1, 0.4])
@pytest.mark.parametrize("seed", range(3))
def test_spans_hold_every_ray_that_meets_a_sphere(seed: int, radius: float, orthographic: bool) -> None:
    points, camera, pixels = make_view(seed)
    near, far = spans(points, camera, pixels, orthographic, radius)
    v, u = np.meshgrid(np.arange(HEIGHT) + 0.5, np.arange(WIDTH) + 0.5, indexing="ij")
    side = np.stack([(u - pixels[0, 2]) / pixels[0, 0], (v - pixels[1, 2]) / pixels[1, 1]], axis=-1)
    ones, zeros = np.ones((HEIGHT, WIDTH, 1)), np.zeros((HEIGHT, WIDTH, 1))
    origin = np.concatenate([side, zeros], axis=-1) if orthographic else np.zeros((HEIGHT, WIDTH, 3))
    direction = np.concatenate([0 * side if orthographic else side, ones], axis=-1)
    hits = 0
    for centre in points.astype(float) @ camera[:, :3].T + camera[:, 3]:
        a = (direction**2).sum(axis=-1)
        b = (direction * (centre - origin)).sum(axis=-1)
        root = b * b - a * (((centre - origin) ** 2).sum(axis=-1) - (0.999 * radius) ** 2)
        leave = (b + np.sqrt(np.maximum(root, 0))) / a
        enter = np.maximum((b - np.sqrt(np.maximum(root, 0))) / a, 0)
        hit = (root > 0) & (leave > 0)
        hits += hit.sum()
        assert (near[hit] <= enter[hit] + 1e-5).all() and (far[hit] >= leave[hit] - 1e-5).all()
    assert hits


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_spans_equal_the_twin(seed: int, orthographic: bool) -> None:
    points, camera, pixels = make_view(seed)
    found = spans(points, camera, pixels, orthographic, 0.1)
    near, far = torch.full((HEIGHT, WIDTH), torch.inf), torch.zeros(HEIGHT, WIDTH)
    reference.splat_spans(*(tensors(a) for a in (points, camera, pixels)), orthographic, 0.1, near, far)
    # 0.1 is float32 in the kernel and float64 in the twin: where a silhouette ends on a border, pixels may differ.
    finite = np.isfinite(found[0])
    assert (np.isfinite(near.numpy()) == finite).mean() > 0.995
    both = finite & np.isfinite(near.numpy())
    assert np.isclose(found[0], near, rtol=0, atol=1e-5)[both].mean() > 0.995
    assert np.isclose(found[1], far, rtol=0, atol=1e-5)[both].mean() > 0.995


def test_small_spheres_mark_few_pixels() -> None:
    camera, pixels = np.eye(3, 4), np.array([[50.0, 0, 28.0], [0, 50.0, 20.0], [0, 0, 1]])
    near, far = spans(np.array([[0.0, 0.0, 2.0]], dtype=np.float32), camera, pixels, False, 0.1)
    # 5 pixels across, and one more on each side for rays beside their pixel's centre.
    assert (np.ptp(np.argwhere(far > 0), axis=0) < 5 + 3).all()
    np.testing.assert_allclose(near[far > 0], 1.9, rtol=1e-6)
    np.testing.assert_allclose(far[far > 0], 2.1, rtol=1e-6)


# Pruning


def make_prunable(seed: int, rays: int = 80) -> tuple[tuple[np.ndarray, ...], Occupancy[Any]]:
    """first, depth, points, part, failed: several roots a sample, some alike, some failed, some outside all cells."""
    generator = np.random.default_rng(seed)
    occupancy = make_occupancy(generator, filled=0.6)
    counts = generator.integers(0, 25, rays)
    first = np.concatenate([[0], np.cumsum(counts)])
    depth = np.concatenate([np.sort(generator.integers(0, 10, n)) for n in counts]).astype(np.float32)
    points = generator.uniform(-0.5, 0.6, (first[-1], 3)).astype(np.float32)
    twin = np.flatnonzero(generator.random(first[-1]) < 0.3)[1:]
    points[twin] = points[twin - 1] + generator.normal(0, 0.004, (len(twin), 3)).astype(np.float32)
    part = generator.integers(0, 3, first[-1]).astype(np.int32)
    part[twin] = part[twin - 1]
    return (first, depth, points, part, generator.random(first[-1]) < 0.15), occupancy


def cached(points: np.ndarray, part: np.ndarray, occupancy: Occupancy[Any]) -> np.ndarray:
    """Cached density at every candidate."""
    cells = [
        cell_of(x, occupancy.origins[p], occupancy.inverse_cell, occupancy.dims[p])
        for x, p in zip(points, part, strict=True)
    ]
    return np.array(
        [0.0 if c is None else occupancy.densities[occupancy.first[p] + c] for c, p in zip(cells, part, strict=True)]
    )


@pytest.mark.parametrize("stop", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(3))
def test_prune_equals_the_twin(seed: int, stop: float) -> None:
    candidates, occupancy = make_prunable(seed)
    settings = (0.05, 0.5, stop, 0.01)
    keep = marching.prune(*candidates, *settings, occupancy)
    twin = reference.prune(*(tensors(a) for a in candidates), *settings, tensors(occupancy))
    assert keep.dtype == bool and keep.any() and not keep.all()
    np.testing.assert_array_equal(keep, twin)
    np.testing.assert_array_equal(keep, marching.prune(*candidates, *settings, occupancy))


@pytest.mark.parametrize("seed", range(3))
def test_what_is_dropped_does_not_show(seed: int) -> None:
    """True densities from ``trust`` times the cached ones let through no more than ``stop`` to what is hidden."""
    candidates, occupancy = make_prunable(seed)
    first, depth, points, part, failed = candidates
    step, trust, stop, apart = 0.2, 0.5, 0.05, 0.01
    keep = marching.prune(*candidates, step, trust, stop, apart, occupancy)
    density = np.where(failed, 0.0, cached(points, part, occupancy))
    assert not keep[density == 0].any()
    factors = np.random.default_rng(seed).uniform(trust, 2.0, len(density))
    hidden = 0
    for begin, end in pairwise(first):
        light = 1.0
        for at in np.unique(depth[begin:end]):
            same = begin + np.flatnonzero(depth[begin:end] == at)
            for m in same[(density[same] > 0) & ~keep[same]]:
                alike = [
                    k for k in same[same < m]
                    if keep[k] and part[k] == part[m] and np.linalg.norm(points[k] - points[m]) < apart + 1e-6
                ]  # fmt: skip
                assert alike or light <= stop + 1e-6
                hidden += not alike
            light *= np.exp(-(density * factors)[same].max() * step)
    assert hidden


def test_nothing_is_hidden_without_a_stop() -> None:
    candidates, occupancy = make_prunable(0)
    _, _, points, part, failed = candidates
    keep = marching.prune(*candidates, 1e-4, 0.5, 0.0, 0.0, occupancy)
    np.testing.assert_array_equal(keep, ~failed & (cached(points, part, occupancy) > 0))


def test_prune_nothing() -> None:
    candidates, occupancy = make_prunable(0)
    none = (np.zeros(4, dtype=np.int64), *(a[:0] for a in candidates[1:]))
    assert marching.prune(*none, 0.05, 0.5, 0.1, 0.01, occupancy).shape == (0,)
    twin = reference.prune(*(tensors(a) for a in none), 0.05, 0.5, 0.1, 0.01, tensors(occupancy))
    assert twin.shape == (0,)


# Carving


@pytest.mark.parametrize("seed", range(2))
def test_carve_counts(seed: int) -> None:
    points, camera, pixels = make_view(seed)
    generator = np.random.default_rng(seed)
    points = np.concatenate([points, generator.normal(0, 0.4, (500, 3)).astype(np.float32)])
    mask = generator.random((HEIGHT, WIDTH)) < 0.5
    inside, seen = np.ones(len(points), dtype=np.int32), np.zeros(len(points), dtype=np.int32)
    marching.carve(points, camera, pixels, mask, inside, seen)
    moved = points.astype(float) @ camera[:, :3].T + camera[:, 3]
    image = moved @ pixels.T
    u, v = np.floor(image[:, 0] / image[:, 2]).astype(int), np.floor(image[:, 1] / image[:, 2]).astype(int)
    visible = (moved[:, 2] > 0) & (u >= 0) & (v >= 0) & (u < WIDTH) & (v < HEIGHT)
    np.testing.assert_array_equal(seen, visible)
    np.testing.assert_array_equal(inside - 1, visible & mask[np.clip(v, 0, HEIGHT - 1), np.clip(u, 0, WIDTH - 1)])
    twin_inside, twin_seen = torch.ones(len(points), dtype=torch.int32), torch.zeros(len(points), dtype=torch.int32)
    reference.carve(*(tensors(a) for a in (points, camera, pixels, mask)), twin_inside, twin_seen)
    np.testing.assert_array_equal(twin_inside, inside)
    np.testing.assert_array_equal(twin_seen, seen)

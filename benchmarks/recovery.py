"""How often root finding gives back canonical points that are known by construction, and what it says where it fails.

100,000 (pose, point) pairs: random joint angles from mild to absurd, and the poses of a capture where one is at hand.
The map is the same for all (see ``recovery_cases``), and so are the points: Newton from K = 1 … 10 nearest bones and
the background's start, in float32; the same with a second look between its roots; with starts led by a grid; Broyden's
method in float32 and float64; and the voxel path of preset fast. Found is what lies within 1 mm (voxels: 2 mm).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks import basins, broyden
from benchmarks.common import Bench, save
from benchmarks.recovery_cases import (
    ANGLES,
    PLAIN,
    SIZE,
    Body,
    Case,
    captured,
    distance_weights,
    make_case,
    random_poses,
)
from benchmarks.recovery_plot import draw
from benchmarks.recovery_voxels import VoxelBody
from chona_model.deform.between import look_between
from chona_model.deform.inverse import Roots, bone_starts, find_roots
from chona_model.deform.predict import predict
from chona_model.settings import PREDICTED, RENDER_PRESETS, InverseSettings, RenderSettings

PAIRS = 100_000
"""Known roots in all."""

POINTS = 60
"""Of a random pose; a capture has fewer poses, each gets more."""

STARTS = 10
"""Nearest bones started from at most."""

NEAR = 1e-3
"""A root this near the known point is that point, metres."""

TIMED = 2000
"""Points of a timing, at joint angles up to 1.5 radians."""

LED_POSES = 16
"""Poses whose grids are held at a time."""

SETTINGS = InverseSettings()


@dataclass(frozen=True)
class Search:
    """What a search gave for M known roots: found [M, K'] by start (the background's last), any root at all [M]."""

    found: Tensor
    rooted: Tensor

    def shares(self, counts: list[int]) -> list[float]:
        """Share of the known roots that the first K starts and the background's find."""
        return [float(self.found[:, [*range(k), STARTS]].any(dim=1).float().mean()) for k in counts]


def measure(bench: Bench) -> None:
    """Writes ``recovery.json`` and the pictures of ``docs/pictures``."""
    body, poses = PLAIN, []
    if bench.data.is_dir():
        body, poses = captured(bench.dataset([*bench.train, *bench.test]))
    report = recovery(body, poses, PAIRS)
    report["points_per_cpu_second"] = speeds(body, bench.runs)
    save("recovery", report)
    draw(report)
    basins.draw()


def recovery(body: Body, poses: list[np.ndarray], pairs: int) -> dict[str, Any]:
    """Shares of ``pairs`` known roots that every method finds, by kind of pose."""
    kinds = [f"{angle} rad" for angle in ANGLES] + (["capture"] if poses else [])
    share, voxels, report = pairs // len(kinds), VoxelBody.of(body), {}
    for number, kind in enumerate(kinds):
        if kind == "capture":
            case = make_case(body, poses, -(-share // len(poses)), number)
        else:
            count = -(-share // POINTS)
            case = make_case(body, random_poses(body, ANGLES[number], count, number), POINTS, number)
        report[kind] = {"pairs": len(case.x), **of_case(case, voxels)}
    return {"surface": body.vertices is not None, "kinds": report}


def of_case(case: Case, voxels: VoxelBody) -> dict[str, Any]:
    """Every method on one kind of poses."""
    counts = list(range(1, STARTS + 1))
    single = case.to(torch.float32)
    starts, _ = starts_of(single, STARTS)
    every = torch.ones(starts.shape[:2], dtype=torch.bool)
    roots = find_roots(single.warp, single.targets, starts, every, size=SIZE, settings=SETTINGS)
    found = {"newton_float32": found_by(roots, single).shares(counts)}
    for name, known in (("broyden_float32", single), ("broyden_float64", case)):
        bones, _ = starts_of(known, STARTS)
        done = broyden.solve(known.warp, known.targets, bones)
        points = done.points.view(*bones.shape)
        near = (points - known.x[:, None]).norm(dim=-1) < NEAR
        found[name] = Search(near & done.converged.view(near.shape), every[:, 0]).shares(counts)
    rows: dict[str, Any] = {"found_by_starts": found}
    for count in (3, 5):
        rows[f"newton_between_{count}"] = share_of(between(single, count), single)
    rows["newton_led_5"] = share_of(led(single, 5), single)
    rows |= {name: of_voxels(voxels, case, RENDER_PRESETS[name]) for name in ("final", "exact")}
    by_broyden = broyden.solve(single.warp, single.targets, starts_of(single, 5)[0])
    rows["evaluations_5"] = {
        "newton": float(newton(single, 5).iterations.sum() / len(case.x)),
        "newton_between": float(between(single, 5).iterations.sum() / len(case.x)),
        "broyden": float(by_broyden.evaluations.sum() / len(case.x)),
    }
    rows["honesty"] = honesty(case, single)
    return rows


def starts_of(case: Case, count: int) -> tuple[Tensor, Tensor]:
    """Starts of the ``count`` nearest bones and the background, and which are worth following."""
    boxes = case.poses.heads.new_zeros(len(case.poses.heads), 0, 2, 3)
    return bone_starts(case.targets, case.poses, case.index, count=count, object_boxes=boxes, size=SIZE)


def newton(case: Case, count: int) -> Roots:
    """As the paper's path searches."""
    starts, usable = starts_of(case, count)
    return find_roots(case.warp, case.targets, starts, usable, size=SIZE, settings=SETTINGS)


def between(case: Case, count: int) -> Roots:
    """The same, with a second look between its roots."""
    starts, usable = starts_of(case, count)
    roots = find_roots(case.warp, case.targets, starts, usable, size=SIZE, settings=SETTINGS)
    return look_between(case.warp, case.targets, starts, usable, roots, size=SIZE, settings=SETTINGS)


class _Logits:
    """What ``predict`` reads off at nodes: the logits of ``distance_weights``, and a background that weighs nothing."""

    def __init__(self, case: Case) -> None:
        self.skinning, self.case = self, case

    def logits(self, x: Tensor) -> Tensor:
        weights = distance_weights(x, self.case.poses.heads[0], self.case.poses.tails[0])[0]
        return torch.cat([weights.log().clamp(min=-80.0), torch.full_like(weights[:, :1], -1e4)], dim=1)


def led(case: Case, count: int) -> Roots:
    """Starts led by a grid first (``InverseSettings.predict``), a few poses' grids at a time."""
    starts, usable = starts_of(case, count)
    starts, usable = starts.clone(), usable.clone()
    known = torch.cat([case.poses.heads[0], case.poses.tails[0]])
    lower, upper = known.amin(dim=0) - 0.25, known.amax(dim=0) + 0.25
    for begin in range(0, len(case.poses.transforms), LED_POSES):
        poses = type(case.poses)(**{name: part[begin : begin + LED_POSES] for name, part in vars(case.poses).items()})
        prediction = predict(_Logits(case), poses, lower, upper, PREDICTED)  # type: ignore[arg-type]
        own = ((case.index >= begin) & (case.index < begin + LED_POSES)).nonzero()[:, 0]
        lead = prediction.lead(case.targets[own], starts[own], usable[own], case.index[own] - begin, None)
        starts[own], usable[own] = lead.starts, lead.follow
    return find_roots(case.warp, case.targets, starts, usable, size=SIZE, settings=SETTINGS)


def found_by(roots: Roots, case: Case) -> Search:
    """Which columns of a search are the known root, and which targets got any root."""
    near = (roots.points - case.x[:, None]).norm(dim=-1) < NEAR
    return Search(near & roots.converged, roots.converged.any(dim=-1))


def share_of(roots: Roots, case: Case) -> float:
    """Share of the known roots among the distinct ones."""
    near = ((roots.points - case.x[:, None]).norm(dim=-1) < NEAR) & roots.distinct
    return float(near.any(dim=-1).float().mean())


def of_voxels(voxels: VoxelBody, case: Case, settings: RenderSettings) -> dict[str, float]:
    """The voxel path with its two starts a posed cell: found; and of the others, how many pixels would be marked."""
    rows = []
    for pose, transforms in enumerate(case.poses.transforms.float()):
        own = case.x[case.index == pose].float().numpy()
        rows.append(np.stack(voxels.find(transforms[: len(case.body.joints)], own, settings)))
    found, accepted, started = np.concatenate(rows, axis=1)
    lost = max(int((~found).sum()), 1)
    return {
        "found": float(found.mean()), "lost_and_marked": float((~found & ~accepted & started).sum() / lost),
        "lost_and_another_root": float((~found & accepted).sum() / lost),
        "lost_without_starts": float((~found & ~started).sum() / lost),
    }  # fmt: skip


def honesty(exact: Case, case: Case) -> dict[str, float]:
    """What K = 5 says where it does not find the known root.

    ``flagged``: of the lost, those without any root (``Roots.found`` is False: confidence falls). ``another_root``:
    those with a true root elsewhere. ``false_confidence``: of all roots called converged, those whose residual in
    float64 is above twice the tolerance.
    """
    roots = newton(case, 5)
    lost = ~(((roots.points - case.x[:, None]).norm(dim=-1) < NEAR) & roots.converged).any(dim=-1)
    target, start = roots.converged.nonzero(as_tuple=True)
    posed = torch.cat([
        exact.warp(points, rows)[0]
        for points, rows in zip(roots.points[target, start].double().split(8192), target.split(8192), strict=True)
    ])  # fmt: skip
    wrong = (posed - exact.targets[target]).norm(dim=-1) > 2 * SETTINGS.tolerance * SIZE
    count = max(int(lost.sum()), 1)
    return {
        "lost": float(lost.float().mean()), "flagged": float((lost & ~roots.found).sum() / count),
        "another_root": float((lost & roots.found).sum() / count), "false_confidence": float(wrong.float().mean()),
    }  # fmt: skip


def speeds(body: Body, runs: int) -> dict[str, float]:
    """Points a second of the processor's time, methods in turn, medians: neighbours on a busy machine do not count."""
    exact = make_case(body, random_poses(body, 1.5, TIMED // POINTS, 99), POINTS, 99)
    case, voxels = exact.to(torch.float32), VoxelBody.of(body)
    works: dict[str, Callable[[], object]] = {
        "newton_5": lambda: newton(case, 5),
        "newton_3": lambda: newton(case, 3),
        "newton_between_3": lambda: between(case, 3),
        "newton_between_5": lambda: between(case, 5),
        "newton_led_5": lambda: led(case, 5),
        "broyden_5_float32": lambda: broyden.solve(case.warp, case.targets, starts_of(case, 5)[0]),
        "broyden_5_float64": lambda: broyden.solve(exact.warp, exact.targets, starts_of(exact, 5)[0]),
        "voxels_final": lambda: of_voxels(voxels, exact, RENDER_PRESETS["final"]),
    }
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(runs):
        for name, work in works.items():
            began = time.process_time()
            work()
            seconds[name].append(time.process_time() - began)
    return {name: len(case.x) / median(values) for name, values in seconds.items()}

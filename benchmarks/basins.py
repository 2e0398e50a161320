"""Basins of attraction at a bent elbow: which start ends at which root, by Newton's and by Broyden's method.

The elbow is bent by 150° and the target lies in its fold, where the forearm's skin meets the upper arm's: the same
posed point has several canonical ones.  Every pixel of the arm's canonical plane is a start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from benchmarks import broyden
from benchmarks.recovery_cases import PLAIN, SIZE, Case, make_case
from benchmarks.recovery_plot import PICTURES
from chona_model.deform.inverse import bone_starts, find_roots, first_of_equals
from chona_model.settings import InverseSettings
from chona_model.skeleton import forward_kinematics

SHOULDER, ELBOW, WRIST = 16, 18, 20
"""The left arm's bones in SMPL."""

BEND = 150.0
"""Degrees."""

PIXELS = 240
"""Along the arm."""

LEFT, RIGHT, LOW, HIGH = 0.10, 0.75, 0.30, 0.62
"""The part of canonical space that is shown, metres."""


def bent_elbow() -> Case:
    """One pose whose target is a point beside the elbow, 5 cm on its inner side."""
    turns = np.tile(np.eye(3), (len(PLAIN.joints), 1, 1))
    turns[ELBOW] = Rotation.from_euler("z", BEND, degrees=True).as_matrix()
    pose = forward_kinematics(PLAIN.skeleton, PLAIN.joints, turns, np.zeros(3))
    case = make_case(PLAIN, [pose], 1, 0)
    x = torch.tensor(PLAIN.joints[ELBOW] + np.array([0.02, 0.055, 0.0]))[None]
    return Case(PLAIN, case.poses, x, case.warp(x, torch.zeros(1, dtype=torch.int64))[0], case.index)


def roots_of(points: Tensor, converged: Tensor) -> tuple[Tensor, Tensor]:
    """The distinct roots [R, 3] among points [A, 3], and which one each is [A]; −1 for none."""
    kept: list[Tensor] = []
    which = torch.full((len(points),), -1)
    while bool((left := converged & (which < 0)).any()):
        root = points[left.nonzero()[0, 0]]
        which[left & ((points - root).norm(dim=-1) < 1e-3)] = len(kept)
        kept.append(root)
    return torch.stack(kept), which


def draw() -> None:
    """Writes ``docs/pictures/basins.png``."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    case = bent_elbow()
    height = round(PIXELS * (HIGH - LOW) / (RIGHT - LEFT))
    y, x = torch.meshgrid(torch.linspace(HIGH, LOW, height).double(), torch.linspace(LEFT, RIGHT, PIXELS).double(),
                          indexing="ij")  # fmt: skip
    z = torch.full_like(x, float(PLAIN.joints[ELBOW, 2]))
    starts = torch.stack([x, y, z], dim=-1).reshape(-1, 1, 3)
    case = replace(case, targets=case.targets.expand(len(starts), 3), index=case.index.expand(len(starts)))
    every = torch.ones(starts.shape[:2], dtype=torch.bool)
    newton = find_roots(case.warp, case.targets, starts, every, size=SIZE, settings=InverseSettings())
    other = broyden.solve(case.warp, case.targets, starts)
    converged = torch.cat([newton.converged[:, 0], other.converged])
    roots, which = roots_of(torch.cat([newton.points[:, 0], other.points]), converged)
    joints = PLAIN.joints[[SHOULDER, ELBOW, WRIST]]
    bones, usable = bone_starts(case.targets[:1], case.poses, case.index[:1], count=5,
                                object_boxes=torch.zeros(1, 0, 2, 3).double())  # fmt: skip
    bones = bones[0, first_of_equals(bones, usable, 1e-6)[0]]
    shown = min(len(roots), 7)
    colours = np.concatenate([[[0.15, 0.15, 0.15]], pyplot.get_cmap("Pastel1")(np.arange(shown))[:, :3], [[1, 1, 1]]])
    figure, panels = pyplot.subplots(1, 2, figsize=(10, 3.1), layout="constrained")
    for axes, name, part in zip(panels, ("Newton", "Broyden"), which.chunk(2), strict=True):
        axes.imshow(colours[part.clamp(max=shown).reshape(height, PIXELS) + 1], extent=(LEFT, RIGHT, LOW, HIGH))
        axes.plot(joints[:, 0], joints[:, 1], "k-", lw=2)
        axes.plot(bones[:, 0], bones[:, 1], "k^", ms=6, label="starts of the nearest bones")
        axes.plot(roots[:, 0], roots[:, 1], "k*", ms=9, label="roots")
        axes.set(xlim=(LEFT, RIGHT), ylim=(LOW, HIGH), title=f"{name}: {100 * float((part >= 0).float().mean()):.1f} %"
                 " of the starts end at a root")  # fmt: skip
        axes.legend(fontsize=7, loc="lower right")
    PICTURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURES / "basins.png", dpi=72)
    pyplot.close(figure)

"""What frames cost as they grow: empty borders, covered pixels, objects, bones, frames that repeat."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.common import Bench, held_shot, milliseconds, ratio, save, with_border
from chona_model.bake import bake
from chona_model.deform.voxels import SkinningVolume
from chona_model.formats.shot import Shot, write_shot
from chona_model.progress import Progress
from chona_model.settings import RENDER_PRESETS

TWICE_THE_PIXELS = 2**0.5 - 1
SCALES = (0.5, 1.0, 1.5, 2.0)
BONES = (24, 52, 104)


def measure(bench: Bench) -> None:
    """Writes ``growth.json`` and ``growth.png``."""
    actor, view = bench.seen()
    pose, camera, final = view.pose, view.camera, RENDER_PRESETS["final"]
    wide = with_border(camera, TWICE_THE_PIXELS)
    border = {
        name: round(ratio(2 * bench.runs, lambda s=RENDER_PRESETS[name]: actor.render(pose, camera, s),
                          lambda s=RENDER_PRESETS[name]: actor.render(pose, wide, s)), 3)
        for name in ("preview", "final")
    }  # fmt: skip
    cameras = [camera.scaled(scale) for scale in SCALES]
    covered = [int((actor.render(pose, each, final).alpha > 0).sum()) for each in cameras]
    times = milliseconds(bench.runs, *(lambda c=each: actor.render(pose, c, final) for each in cameras))
    alone = replace(pose, objects=(), world_from_object=np.zeros((0, 4, 4)))
    objects = milliseconds(
        bench.runs, lambda: actor.render(alone, camera, final), lambda: actor.render(pose, camera, final)
    )
    save("growth", {
        "twice_the_pixels_all_empty": border,
        "covered_pixels": covered, "covered_ms": [round(value, 2) for value in times],
        "objects_0_ms": round(objects[0], 2), "objects_1_ms": round(objects[1], 2),
        "bones": list(BONES), "blending_ms": [round(value, 3) for value in _blending(bench, actor.model.grid(0))],
        "repeated_frame_share": round(_repeated(bench, held_shot(pose, camera, actor.skeleton.names, 2)), 3),
    })  # fmt: skip
    _plot(covered, times)


def _blending(bench: Bench, grid) -> list[float]:
    """Milliseconds to blend one pose's matrices at every node, by the number of bones."""
    works = []
    for bones in BONES:
        volume = SkinningVolume(grid, bones, 6 * bones, 0)
        transforms = torch.eye(4).repeat(bones, 1, 1)

        def work(volume=volume, transforms=transforms) -> None:
            with torch.inference_mode():
                volume.blend_padded(transforms, None)

        works.append(work)
    return milliseconds(bench.runs, *works)


def _repeated(bench: Bench, shot: Shot) -> float:
    """What a frame that equals an earlier one takes, as a share of rendering it; file writing included in both."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "held.shot.npz"
        write_shot(path, shot)
        shares = []
        for run in range(3):
            reports = [
                bake(bench.model, path, Path(folder) / f"{run}", frames, "final", True, Progress())
                for frames in ([0], [0, 1])
            ]
            shares.append((reports[1].seconds - reports[0].seconds) / reports[0].seconds)
    return float(np.median(shares))


def _plot(covered: list[int], times: list[float]) -> None:
    from benchmarks.plots import line

    line("growth", covered, {"final": times}, "covered pixels", "milliseconds a frame")

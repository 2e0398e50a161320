"""What the samples of motion blur and depth of field cost, and how far they leave a frame from one of very many."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from benchmarks.common import Bench, held_shot, save
from chona_model.blur import Blur
from chona_model.data.dataset import View
from chona_model.formats.shot import Lens, Shot, Shutter
from chona_model.frame import ShotRenderer
from chona_model.grid_actor import GridActor
from chona_model.settings import RENDER_PRESETS
from chona_model.skeleton import translation

SAMPLES, MANY, MOMENTS_PER_SAMPLE = (4, 8, 16, 32), 64, 2
STREAK, SPOT = 0.05, 0.02
"""How far the figure moves, and the radius that a point far behind it would have, in picture widths."""

CASES = {"motion": (True, False), "focus": (False, True), "both": (True, True)}


def measure(bench: Bench) -> None:
    """Writes ``blur.json``: by what blurs and by samples, milliseconds, and root mean square errors where it shows."""
    actor, view = bench.seen()
    result: dict[str, object] = {"size": [view.camera.width, view.camera.height], "samples": list(SAMPLES)}
    for name, (motion, focus) in CASES.items():
        reference = _render(actor, _shot(actor, view, MANY), Blur(motion, focus, MANY))[0]
        shown = reference[..., 3] > 0
        taken, errors = [], []
        for samples in SAMPLES:
            picture, milliseconds = _render(actor, _shot(actor, view, samples), Blur(motion, focus, samples))
            taken.append(round(milliseconds))
            errors.append(round(float(np.sqrt(((picture - reference)[shown] ** 2).mean())), 4))
        result[name] = {"milliseconds": taken, "error": errors}
    result["sharp_ms"] = round(_render(actor, _shot(actor, view, 1), Blur())[1])
    save("blur", result)


def _render(actor: GridActor, shot: Shot, blur: Blur) -> tuple[np.ndarray, float]:
    """The frame's pixels, and milliseconds; poses are made ready anew, as in a bake."""
    actor.forget_poses()
    began = time.perf_counter()
    layers = ShotRenderer([actor], shot, RENDER_PRESETS["preview"], blur=blur).render(0)
    return layers.combined, 1e3 * (time.perf_counter() - began)


def _shot(actor: GridActor, view: View, samples: int) -> Shot:
    """The view with a shutter over which the figure moves to the right, and a lens that focuses before it."""
    shot, count = held_shot(view.pose, view.camera, actor.skeleton.names, 1), MOMENTS_PER_SAMPLE * samples
    times = (np.arange(count) + 0.5) / count - 0.5
    member, camera = shot.actors[0], view.camera
    depth = np.linalg.norm(member.world_from_bone[0, 0, :3, 3] - camera.world_from_camera[:3, 3])
    focal = camera.intrinsics[0, 0]
    way = STREAK * camera.width * depth / focal * camera.world_from_camera[:3, 0]
    moved = np.stack([translation(moment * way) for moment in times])[:, None]
    shutter = Shutter(
        times, np.repeat(shot.intrinsics[:, None], count, axis=1),
        np.repeat(shot.world_from_camera[:, None], count, axis=1), ((moved @ member.world_from_bone[0])[None],),
        ((moved @ member.world_from_object[0])[None],),
    )  # fmt: skip
    near = 0.5 * depth
    radius = SPOT * camera.width * near / focal
    lens = Lens(*(np.array([value]) for value in (near, radius, 0.0, 0.0, 1.0)))
    return replace(shot, shutter=shutter, lens=lens)

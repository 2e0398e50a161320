"""Times a trained model's frames on this machine: presets, parts of a frame, and what a larger picture costs.

    python scripts/benchmark.py --model run/model.safetensors --data DATA --format behave --sequences NAME

Medians of several runs in one process, after a first one that compiles kernels. Writes a table in Markdown.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median

from chona_model.process import tune

tune()  # before torch is imported

import numpy as np  # noqa: E402

from chona_model import grid_view  # noqa: E402
from chona_model.camera import Camera  # noqa: E402
from chona_model.data.opener import open_dataset  # noqa: E402
from chona_model.grid_actor import GridActor  # noqa: E402
from chona_model.model_store import load_actor  # noqa: E402
from chona_model.settings import RENDER_PRESETS  # noqa: E402

RUNS = 9
HEAD = """| preset | new pose, ms | same pose, ms | pose ready | spans | rays | field evaluations |
|---|---|---|---|---|---|---|
"""


def timed(work: Callable[[], object]) -> float:
    """Median milliseconds of ``work``; the first call does not count."""
    work()
    seconds = []
    for _ in range(RUNS):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return 1e3 * median(seconds)


def with_border(camera: Camera, share: float) -> Camera:
    """The same view with an empty border around it: ``share`` more pixels along each axis."""
    width, height = round(camera.width * (1 + share)), round(camera.height * (1 + share))
    intrinsics = camera.intrinsics.copy()
    intrinsics[0, 2] += (width - camera.width) / 2
    intrinsics[1, 2] += (height - camera.height) / 2
    return replace(camera, intrinsics=intrinsics, width=width, height=height)


def main() -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--format", default="auto")
    parser.add_argument("--sequences", required=True, help="names, separated by commas")
    parser.add_argument("--view", type=int, default=5, help="which of the views (default 5)")
    options = parser.parse_args()
    actor = load_actor(options.model)
    if not isinstance(actor, GridActor):
        parser.error(f"{options.model} is not a grid model (preset fast)")
    dataset = open_dataset(options.data, options.format, sequences=options.sequences.split(","))
    view = dataset.views[options.view]
    sys.stdout.write(f"{view.label}, {view.camera.width}x{view.camera.height}, medians of {RUNS}\n\n")
    sys.stdout.write(HEAD)
    for name in ("draft", "preview", "final"):
        settings = RENDER_PRESETS[name]
        camera = view.camera.scaled(settings.resolution)

        def new_pose(settings=settings) -> None:
            actor.forget_poses()
            actor.render(view.pose, view.camera, settings)

        again = timed(lambda settings=settings: actor.render(view.pose, view.camera, settings))
        ready = actor.ready(view.pose, settings)
        make = timed(lambda settings=settings: (actor.forget_poses(), actor.ready(view.pose, settings)))
        spans = timed(lambda camera=camera, ready=ready: grid_view.depth_spans(ready.part, ready.figure.figure, camera))
        seen = grid_view.render_view(actor.model, ready, camera, settings)
        rays = len(seen.rows) * settings.supersampling**2
        sys.stdout.write(
            f"| {name} | {timed(new_pose):.0f} | {again:.0f} | {make:.1f} | {spans:.1f} | {rays} | {seen.evaluated} |\n"
        )
    final = RENDER_PRESETS["final"]
    whole = timed(lambda: actor.render(view.pose, view.camera, final))
    wide = timed(lambda: actor.render(view.pose, with_border(view.camera, 0.414), final))
    large = view.camera.scaled(2.0)
    covered = [int((actor.render(view.pose, camera, final).alpha > 0).sum()) for camera in (view.camera, large)]
    twice = timed(lambda: actor.render(view.pose, large, final))
    ratio = covered[1] / covered[0]
    sys.stdout.write(
        f"\nTwice the pixels, all of them empty: {100 * (wide / whole - 1):+.1f} % time. "
        f"{ratio:.2f} times the covered pixels: {twice / whole:.2f} times the time.\n"
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    sys.stdout.write(f"Peak memory of this process: {peak:.2f} GiB; numpy {np.__version__}.\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

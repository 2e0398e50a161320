"""What ``chona farm`` and ``chona bake --dask`` do."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path

from chona_model.arguments import UsageError, writable_folder
from chona_model.command_line import PATIENCE
from chona_model.command_parts import DONE, finish
from chona_model.progress import Progress


def bake_on_cluster(arguments: argparse.Namespace, progress: Progress) -> int:
    """Has a cluster render a shot, after what can be wrong has been looked at here."""
    if importlib.util.find_spec("distributed") is None:
        raise UsageError(
            "--dask needs the package distributed, which is not installed; install it here and on the workers: "
            "pip install distributed"
        )
    from chona_model.bake import choose_frames
    from chona_model.farm.chunks import chunks_of
    from chona_model.farm.dask_bake import bake_on_dask
    from chona_model.formats.shot import read_shot
    from chona_model.shot_models import find_models

    shot = read_shot(arguments.shot)
    find_models(shot, arguments.model, arguments.shot.parent)
    chosen = [int(shot.frames[index]) for index in choose_frames(shot, arguments.frames)]
    own = Path(arguments.preset)
    options: dict[str, object] = {
        "model": arguments.model.absolute(), "shot": arguments.shot.absolute(), "out": arguments.out.absolute(),
        "preset": own.absolute() if own.is_file() else own, "max-error": arguments.max_error,
        "share": arguments.share or PATIENCE, "passes": ",".join(arguments.passes), "device": arguments.device,
        "motion-blur": arguments.motion_blur, "depth-of-field": arguments.depth_of_field,
    }  # fmt: skip
    if arguments.blur_samples is not None:
        options["blur-samples"] = arguments.blur_samples
    words = ["bake", *(f"--{name}={value}" for name, value in options.items())]
    progress.start("bake", len(chosen), unit="frame")
    total = bake_on_dask(
        arguments.dask,
        words + ["--only-missing"] * arguments.only_missing,
        chunks_of(chosen, arguments.chunk),
        progress,
    )
    return finish(
        progress, f"{total['written']} frames written, {total['skipped']} were up to date: {arguments.out}", **total,
        out=str(arguments.out),
    )  # fmt: skip


def farm_command(arguments: argparse.Namespace, _progress: Progress) -> int:
    """Writes what a farm's manager needs."""
    from chona_model.farm.files import write_file

    target = write_file(arguments.manager, writable_folder(arguments.out, "--out"))
    sys.stdout.write(f"{target}\n")
    return DONE

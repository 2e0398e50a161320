"""What every command of ``chona`` does: arguments checked, the work called, its end reported.

Exit codes: 0 done, 1 failed or cancelled, 2 bad arguments or input.  Every command imports what it needs when it runs.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path

from chona_model import process
from chona_model.arguments import UsageError, sources_of, writable_file, writable_folder
from chona_model.command_parts import DONE, FAILED, finish, open_sources, resolve_device, with_others
from chona_model.passes import Passes
from chona_model.presets import find_preset
from chona_model.progress import Progress

VIEWS_CHECKED = 9
"""Of every sequence by ``check-data``: a picture of three rows."""


def train_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Learns a model."""
    sources_of(arguments.sources)
    with with_others(progress) as writes:
        out = writable_folder(arguments.out, "--out") if writes else arguments.out
        dataset, statement = open_sources(arguments)
        progress.check()
        device = resolve_device(arguments.device)
        from chona_model.train.run import TrainRun, train

        progress.check()
        run = TrainRun(
            method=arguments.method, preset=arguments.preset, minutes=arguments.minutes, steps=arguments.steps,
            image_scale=arguments.image_scale, device=device, seed=arguments.seed, resume=arguments.resume,
            data_statement=statement, preview_every=arguments.preview_every,
        )  # fmt: skip
        model = train(dataset, out, run, progress)
    return finish(progress, f"wrote {model}", model=str(model))


def evaluate_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Measures a model."""
    from chona_model.formats.model_file import read_header

    sources_of(arguments.sources)
    find_preset(arguments.preset)
    read_header(arguments.model)
    report = writable_file(arguments.json, "--json")
    if arguments.save_images is not None:
        writable_folder(arguments.save_images, "--save-images")
    dataset, _ = open_sources(arguments)
    progress.check()
    device = resolve_device(arguments.device)
    from chona_model.evaluate.run import evaluate

    progress.check()
    result = evaluate(
        arguments.model, dataset, arguments.preset, arguments.image_scale, arguments.save_images, report, progress,
        device=device,
    )  # fmt: skip
    mean = result.get("mean", {})
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in mean.items() if isinstance(value, int | float))
    return finish(progress, f"{numbers}; wrote {report}", json=str(report), mean=mean)


def bake_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Renders a shot."""
    from chona_model.formats.model_file import read_header

    passes = Passes.of(arguments.passes)
    if (arguments.share or arguments.dask) and arguments.overwrite:
        given = "--dask" if arguments.dask else "--share"
        raise UsageError(
            f"both {given} and --overwrite are given, and each of those who share would bake every frame again; delete "
            "the frames, or leave one of the two out"
        )
    find_preset(arguments.preset)  # refused before anything is read
    read_header(arguments.model)
    out = writable_folder(arguments.out, "--out")
    if arguments.dask is not None:
        from chona_model.farm_commands import bake_on_cluster

        return bake_on_cluster(arguments, progress)
    device = resolve_device(arguments.device)
    from chona_model.bake import bake
    from chona_model.blur import BlurChoice

    progress.check()
    report = bake(
        arguments.model, arguments.shot, out, arguments.frames, arguments.preset, arguments.overwrite, progress,
        device=device, passes=passes, max_error=arguments.max_error,
        blur=BlurChoice(arguments.motion_blur, arguments.depth_of_field, arguments.blur_samples),
        only_missing=arguments.only_missing, max_memory=arguments.max_memory, share=arguments.share,
    )  # fmt: skip
    words = f"{report.sentence()}: {out}\n{report.left_out.sentence()}".rstrip()
    return finish(progress, words, **report.as_dict())


def trade_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Measures what speed costs."""
    from chona_model.formats.model_file import read_header

    sources_of(arguments.sources)
    read_header(arguments.model)
    out = writable_folder(arguments.out, "--out")
    if arguments.save_preset is not None and arguments.seconds_per_frame is None and arguments.psnr is None:
        raise UsageError(
            f"--save-preset is '{arguments.save_preset}', but nothing was asked for; say what the preset must "
            "reach with --seconds-per-frame or --psnr"
        )
    if not arguments.no_save:
        writable_file(arguments.model, "--model (or use --no-save)")
    dataset, _ = open_sources(arguments)
    progress.check()
    device = resolve_device(arguments.device)
    from chona_model.trade.report import table
    from chona_model.trade.run import TradeRun, measure_trade

    run = TradeRun(
        arguments.minutes, arguments.full, arguments.image_scale, arguments.seconds_per_frame, arguments.psnr,
        arguments.save_preset, not arguments.no_save, device,
    )  # fmt: skip
    trade = measure_trade(arguments.model, dataset, out, run, progress)
    rows = list(trade.presets.items()) + ([("chosen", trade.chosen)] if trade.chosen else [])
    files = {"json": str(out / "trade.json"), "plot": str(out / "trade.png")}
    return finish(progress, f"{table(rows)}wrote {files['json']} and {files['plot']}", **files)


def estimate_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Predicts a bake."""
    from chona_model.formats.model_file import check_trade, read_header
    from chona_model.formats.shot import read_shot

    find_preset(arguments.preset)
    header = read_header(arguments.model)
    if header.trade is not None:
        check_trade(arguments.model, header.trade)
    if arguments.shot is None and header.trade is None:
        raise UsageError(
            f"{arguments.model} was not measured yet, so there is no view to calibrate on; give a --shot, or measure "
            "the model with 'chona trade'"
        )
    device = resolve_device(arguments.device)
    from chona_model.bake import choose_frames
    from chona_model.blur import BlurChoice
    from chona_model.shot_models import find_models
    from chona_model.trade.estimate import estimate, reference_shot

    progress.check()
    progress.start("estimate", arguments.seconds, unit="s")
    names = header.skeleton.names
    shot = reference_shot(header.trade or {}, names) if arguments.shot is None else read_shot(arguments.shot)
    models = find_models(shot, arguments.model, arguments.shot.parent if arguments.shot else None)
    frames = choose_frames(shot, arguments.frames)
    actors = models.load(shot, device).actors
    started = time.perf_counter() - process.BEGAN
    # A ray of another model costs something else: where there are several, all presets are timed here.
    trade = header.trade if set(models.paths) == {arguments.model} else None
    blur = BlurChoice().of(shot)
    found = estimate(actors, shot, frames, trade, arguments.preset, arguments.seconds, started, blur)
    lines = [
        f"{name}: {'' if each.psnr is None else f'{each.psnr:.1f} dB, '}{each.seconds_per_frame:.2f} s a frame here; "
        f"{found.frames} frame{'s' * (found.frames > 1)} ≈ {each.total_seconds:.0f} s"
        for name, each in found.presets.items()
    ]
    return finish(progress, "\n".join(lines), **found.as_dict())


def stand_in_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Makes meshes of a person and objects."""
    from chona_model.formats.model_file import read_header

    if arguments.person is None and not arguments.objects:
        raise UsageError("neither --person nor --objects is given; name a person, objects, or both ('chona info FILE')")
    if arguments.out.suffix != ".npz":
        raise UsageError(f"--out is {arguments.out}, expected a file NAME.npz: give it that ending")
    read_header(arguments.model)
    out = writable_file(arguments.out, "--out")
    device = resolve_device(arguments.device)
    from chona_model.standin.make import StandInSettings, make_stand_in

    progress.check()
    settings = StandInSettings(arguments.voxel, arguments.faces)
    made = make_stand_in(arguments.model, arguments.person, arguments.objects, out, settings, progress, device)
    return finish(progress, f"{made.sentence()}; wrote {out}", out=str(out), **asdict(made))


def serve_command(arguments: argparse.Namespace, _progress: Progress) -> int:
    """Renders what comes in."""
    from chona_model.formats.model_file import read_header

    read_header(arguments.model)
    device = resolve_device(arguments.device)
    from chona_model.serve import serve

    frames = sys.stdout.buffer
    # Libraries print where they like; stdout belongs to the frames.
    with contextlib.redirect_stdout(sys.stderr):
        serve(arguments.model, device, sys.stdin.buffer, frames)
    return DONE


def jobs_command(arguments: argparse.Namespace, _progress: Progress) -> int:
    """Describes jobs that go on by themselves."""
    from chona_model.detached import describe_jobs

    lines = describe_jobs(arguments.folder, arguments.stop)
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    return DONE


def info_command(arguments: argparse.Namespace, _progress: Progress) -> int:
    """Describes a model file."""
    from chona_model.info import describe, to_text

    description = describe(arguments.file)
    sys.stdout.write(json.dumps(description, indent=2) + "\n" if arguments.json else to_text(description))
    return DONE


def check_data_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Describes a capture."""
    from chona_model.data.checks import check_data
    from chona_model.data.opener import guess_format, open_dataset
    from chona_model.data_report import to_fields, to_json, to_text

    if arguments.brief and arguments.out is not None:
        raise UsageError("--brief opens no image, so there is nothing to draw into --out; leave one of the two out")
    if arguments.out is not None:
        writable_folder(arguments.out, "--out")
    if arguments.json is not None:
        writable_file(arguments.json, "--json")
    dataset = open_dataset(arguments.data, arguments.format, body_model_dir=arguments.body_model)
    format = guess_format(arguments.data) if arguments.format == "auto" else arguments.format
    report = check_data(dataset, arguments.out, 0 if arguments.brief else VIEWS_CHECKED, progress)
    if arguments.json is not None:
        from chona_model.formats.atomic import write_bytes

        write_bytes(arguments.json, to_json(report, format).encode())
    # Gaps are ordinary; whatever else is warned of means that the data are damaged or misread.
    sound = len(report.warnings) <= len(report.gaps)
    if progress.mode == "terminal":
        sys.stdout.write(to_text(report, format))
    progress.result(sound=sound, **to_fields(report, format))
    return DONE if sound else FAILED


def doctor_command(arguments: argparse.Namespace, _progress: Progress) -> int:
    """Describes this computer."""
    from chona_model.doctor import examine, to_text

    if arguments.about and arguments.bundle is None:
        raise UsageError(f"--about is {arguments.about[0]}, which belongs to --bundle FILE.zip: give that too")
    if arguments.bundle is not None:
        from chona_model.bundle import write_bundle

        missing = next((path for path in arguments.about if not path.exists()), None)
        if missing is not None:
            raise UsageError(f"--about is {missing}, which does not exist; name a model, a shot, or a folder")
        names = write_bundle(writable_file(arguments.bundle, "--bundle"), arguments.about)
        sys.stdout.write(
            f"wrote {arguments.bundle}, {len(names)} texts without pictures or paths: {', '.join(names)}\n"
        )
        return DONE
    report = examine()
    sys.stdout.write(json.dumps(report, indent=2) + "\n" if arguments.json else to_text(report))
    return DONE if report["ok"] else FAILED


def demo_command(arguments: argparse.Namespace, _progress: Progress) -> int:
    """Does the whole job."""
    root = Path(__file__).resolve().parent.parent
    if not (root / "demo" / "run.py").is_file():
        raise UsageError(
            "chona demo is part of the sources, and this is an installed package without the folder demo; get the "
            "repository, and run 'make demo' or 'python -m chona_model demo' in it"
        )
    if arguments.blender_python is not None and not arguments.blender_python.is_file():
        raise UsageError(
            f"--blender-python is {arguments.blender_python}, which does not exist; expected a Python with the module "
            "bpy: name one, or make one with 'pip install bpy'"
        )
    out = writable_folder(arguments.out, "--out")
    words = ["--out", str(out)]
    if arguments.blender_python is not None:
        words += ["--blender-python", str(arguments.blender_python)]
    if arguments.minutes is not None:
        words += ["--minutes", f"{arguments.minutes:g}"]
    if arguments.quick:
        words.append("--quick")
    sys.path.insert(0, str(root))
    return int(importlib.import_module("demo.run").main(words) or DONE)

"""The command ``chona``: arguments in, exit code out, and one line on stderr when something is wrong.

Exit codes: 0 done, 1 failed or cancelled, 2 bad arguments or input.  Every command imports what it needs when it runs:
``chona info`` and ``--help`` start without torch.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import sys
import traceback
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from chona_model import process
from chona_model.arguments import (
    Parser,
    SourceAction,
    UsageError,
    frame_list,
    glue_frames,
    name_list,
    number,
    sources_of,
    whole,
    writable_file,
    writable_folder,
)
from chona_model.passes import PASSES, Passes
from chona_model.progress import MODES, Cancelled, Progress
from chona_model.settings import PRESETS

if TYPE_CHECKING:
    from chona_model.data.dataset import Dataset

DONE, FAILED, BAD_INPUT = 0, 1, 2
METHODS = ("chona", "no-cil")
LATER_METHODS = ("object-translation", "tava", "arah", "arah-object")
"""Named on the command line; not part of this version."""
TRAIN_PRESETS = ("fast", "paper")
DEFAULT_PRESET = "final"
MAX_SEED = 2**63 - 1
_PRESET_HELP = f"{', '.join(PRESETS)}, or one of yours (default: {DEFAULT_PRESET})"
NAMED_SEQUENCES = 20
"""So many sequences are named in a model's statement of its training data; of more, the number."""

Command = Callable[[argparse.Namespace, Progress], int]


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    process.tune()
    words = glue_frames(sys.argv[1:] if argv is None else argv)
    progress = Progress(_mode(words))
    progress.job = words[0] if words and not words[0].startswith("-") else "chona"
    try:
        # Libraries print where they like; stdout belongs to the events.
        with contextlib.redirect_stdout(sys.stderr) if progress.mode == "json" else contextlib.nullcontext():
            return _run(words, progress)
    except BrokenPipeError:
        # Nobody reads any more: keep Python from failing once more when it flushes stdout at exit.
        sys.stdout = None
        return FAILED


def _run(words: list[str], progress: Progress) -> int:
    try:
        try:
            arguments = make_parser().parse_args(words)
        except SystemExit as end:  # --help and --version
            return int(end.code or 0)
        with progress.cancel if hasattr(arguments, "progress") else contextlib.nullcontext():
            return arguments.run(arguments, progress)
    except (Cancelled, KeyboardInterrupt):
        if progress.ended is None:
            progress.cancelled()
        return FAILED
    except BrokenPipeError:
        raise
    except Exception as error:
        if "--debug" in words:
            traceback.print_exc()
        code = BAD_INPUT if _is_house_error(error) else FAILED
        progress.error(str(error) if code == BAD_INPUT else _describe(error, words), code)
        return code


def _mode(words: Sequence[str]) -> str:
    """The progress mode before anything is parsed, so that parsing errors are reported in it too."""
    return "json" if "--progress=json" in words or ("--progress", "json") in pairwise(words) else "terminal"


def _is_house_error(error: Exception) -> bool:
    """Whether an exception is one of this package's own that speak of the user's input."""
    return isinstance(error, ValueError) and type(error).__module__.partition(".")[0] == "chona_model"


def _describe(error: Exception, words: Sequence[str]) -> str:
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    if isinstance(error, ImportError):
        text += "; 'chona doctor' says what to install"
    return text if "--debug" in words else f"{text} (--debug shows where)"


def make_parser() -> Parser:
    """The whole command line."""
    parser = Parser(prog="chona", description="Train people and objects from captures, and bake posed shots to EXR.")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, dest="command")

    def add(name: str, run: Command, words: str, long: bool = False) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=words, description=words[0].upper() + words[1:] + ".")
        command.set_defaults(run=run)
        command.add_argument("--debug", action="store_true", help="show where an error happened")
        if long:
            command.add_argument("--progress", choices=MODES, default="terminal", help="a bar, or JSON lines on stdout")
            command.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
        return command

    train = add("train", _train, "learn a model from captures", long=True)
    _add_sources(train, "repeat it with its own --format and --sequences or --split to train jointly")
    train.add_argument("--out", type=Path, required=True, metavar="RUN", help="folder for model, log and checkpoint")
    train.add_argument("--method", default="chona", metavar="|".join(METHODS), help="default: chona")
    train.add_argument("--preset", choices=TRAIN_PRESETS, default="fast")
    length = train.add_mutually_exclusive_group()
    length.add_argument("--minutes", type=number(0, above=True), metavar="M", help="how long to train")
    length.add_argument("--steps", type=whole(1, 10**9), metavar="N", help="how many steps to train")
    train.add_argument("--seed", type=whole(0, MAX_SEED), default=0, metavar="N")
    train.add_argument("--resume", action="store_true", help="continue from the checkpoint in RUN")

    evaluate = add("evaluate", _evaluate, "measure a model on views it has not seen", long=True)
    evaluate.add_argument("--model", type=Path, required=True, metavar="FILE")
    _add_sources(evaluate, "repeat it to measure on several")
    evaluate.add_argument("--preset", default=DEFAULT_PRESET, metavar="P", help=_PRESET_HELP)
    evaluate.add_argument("--save-images", type=Path, metavar="DIR", help="folder for predictions and targets")
    evaluate.add_argument("--json", type=Path, required=True, metavar="FILE", help="the measurements")

    bake = add("bake", _bake, "render a shot to EXR frames", long=True)
    bake.add_argument("--model", type=Path, required=True, metavar="FILE")
    bake.add_argument("--shot", type=Path, required=True, metavar="FILE")
    bake.add_argument("--out", type=Path, required=True, metavar="DIR")
    bake.add_argument("--frames", type=frame_list, metavar="1-50,60", help="default: all of the shot")
    bake.add_argument("--preset", default=DEFAULT_PRESET, metavar="P", help=_PRESET_HELP)
    bake.add_argument(
        "--max-error", type=number(0, 0.5), default=0.0, metavar="E",
        help="render pixels again, finer, until their colour and alpha change by no more than this; 0: off",
    )  # fmt: skip
    bake.add_argument("--overwrite", action="store_true", help="bake frames again that are up to date")
    bake.add_argument(
        "--passes", type=name_list, default=list(PASSES), metavar="A,B,…",
        help=f"of {', '.join(PASSES)} (default: all; combined always)",
    )  # fmt: skip

    trade = add("trade", _trade, "measure what speed costs with a model, and find the best settings", long=True)
    trade.add_argument("--model", type=Path, required=True, metavar="FILE")
    _add_sources(trade, "views that training did not see; repeat it to measure on several")
    trade.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for trade.json and trade.png")
    trade.add_argument("--full", action="store_true", help="every value of every setting (default: some, 3 minutes)")
    trade.add_argument("--minutes", type=number(0, above=True), metavar="M", help="how long to measure")
    trade.add_argument(
        "--seconds-per-frame", type=number(0, above=True), metavar="S", help="find the most accurate within this time"
    )
    trade.add_argument("--psnr", type=number(0, above=True), metavar="DB", help="find the fastest above this quality")
    trade.add_argument("--save-preset", metavar="NAME", help="save what was found as a preset of yours")
    trade.add_argument("--no-save", action="store_true", help="leave the model file as it is")

    estimate = add("estimate", _estimate, "say what baking a shot will take on this computer", long=True)
    estimate.add_argument("--model", type=Path, required=True, metavar="FILE")
    estimate.add_argument("--shot", type=Path, metavar="FILE", help="default: the view the model was measured on")
    estimate.add_argument("--frames", type=frame_list, metavar="1-50,60", help="default: all of the shot")
    estimate.add_argument("--preset", default=DEFAULT_PRESET, metavar="P", help=f"to calibrate with; {_PRESET_HELP}")
    estimate.add_argument("--seconds", type=number(0, 600, above=True), default=2.0, metavar="S", help="of calibration")

    served = add("serve", _serve, "stay up and render poses that come in on standard input (for the add-on's previews)")
    served.add_argument("--model", type=Path, required=True, metavar="FILE")
    served.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")

    info = add("info", _info, "show what a model file holds")
    info.add_argument("file", type=Path, metavar="FILE")
    info.add_argument("--json", action="store_true", help="as JSON")

    check = add("check-data", _check_data, "show whether a capture is understood")
    check.add_argument("data", type=Path, metavar="DIR")
    check.add_argument("--format", default="auto", metavar="F")
    check.add_argument("--out", type=Path, metavar="DIR", help="folder for pictures of what was understood")
    _add_body_model(check)
    check.add_argument("--json", type=Path, metavar="FILE", help="the measurements")

    doctor = add("doctor", _doctor, "check what this computer has for the work")
    doctor.add_argument("--json", action="store_true", help="as JSON")

    demo = add("demo", _demo, "make a capture of a character, train it, and bake a shot of it")
    demo.add_argument("--out", type=Path, required=True, metavar="DIR")
    demo.add_argument("--blender-python", type=Path, metavar="PY", help="a Python with the module bpy")
    demo.add_argument("--minutes", type=number(0, above=True), metavar="M", help="how long to train")
    demo.add_argument("--quick", action="store_true", help="small pictures and a short training")
    return parser


def _add_sources(command: argparse.ArgumentParser, several: str) -> None:
    command.add_argument("--data", action=SourceAction, type=Path, metavar="DIR", help=f"a capture; {several}")
    command.add_argument("--format", action=SourceAction, metavar="F", help="its layout (default: auto)")
    command.add_argument("--sequences", action=SourceAction, type=name_list, metavar="A,B,…", help="default: all")
    command.add_argument("--split", action=SourceAction, metavar="FILE:KEY", help="the sequences a JSON file lists")
    command.add_argument("--image-scale", type=number(0, 1, above=True), default=1.0, metavar="S")
    command.set_defaults(sources=None)
    _add_body_model(command)


def _add_body_model(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--body-model", type=Path, metavar="DIR",
        help="SMPL-H files (default: $CHONA_BODY_MODELS, else a folder smplh beside the data)",
    )  # fmt: skip


def _train(arguments: argparse.Namespace, progress: Progress) -> int:
    if arguments.method in LATER_METHODS:
        raise UsageError(f"--method {arguments.method} is not part of this version; it trains {' and '.join(METHODS)}")
    if arguments.method not in METHODS:
        raise UsageError(f"--method is '{arguments.method}', expected {' or '.join(METHODS)}")
    sources_of(arguments.sources)
    out = writable_folder(arguments.out, "--out")
    dataset, statement = _open(arguments)
    progress.check()
    device = resolve_device(arguments.device)
    from chona_model.train.run import TrainRun, train

    progress.check()
    run = TrainRun(
        method=arguments.method, preset=arguments.preset, minutes=arguments.minutes, steps=arguments.steps,
        image_scale=arguments.image_scale, device=device, seed=arguments.seed, resume=arguments.resume,
        data_statement=statement,
    )  # fmt: skip
    model = train(dataset, out, run, progress)
    return _finish(progress, f"wrote {model}", model=str(model))


def _evaluate(arguments: argparse.Namespace, progress: Progress) -> int:
    from chona_model.formats.model_file import read_header

    sources_of(arguments.sources)
    read_header(arguments.model)
    report = writable_file(arguments.json, "--json")
    if arguments.save_images is not None:
        writable_folder(arguments.save_images, "--save-images")
    dataset, _ = _open(arguments)
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
    return _finish(progress, f"{numbers}; wrote {report}", json=str(report), mean=mean)


def _bake(arguments: argparse.Namespace, progress: Progress) -> int:
    from chona_model.formats.model_file import read_header

    passes = Passes.of(arguments.passes)
    read_header(arguments.model)
    out = writable_folder(arguments.out, "--out")
    device = resolve_device(arguments.device)
    from chona_model.bake import bake

    progress.check()
    report = bake(
        arguments.model, arguments.shot, out, arguments.frames, arguments.preset, arguments.overwrite, progress,
        device=device, passes=passes, max_error=arguments.max_error,
    )  # fmt: skip
    words = f"{report.sentence()}: {out}\n{report.left_out.sentence()}".rstrip()
    return _finish(progress, words, **report.as_dict())


def _trade(arguments: argparse.Namespace, progress: Progress) -> int:
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
    dataset, _ = _open(arguments)
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
    return _finish(progress, f"{table(rows)}wrote {files['json']} and {files['plot']}", **files)


def _estimate(arguments: argparse.Namespace, progress: Progress) -> int:
    from chona_model.formats.model_file import read_header
    from chona_model.formats.shot import read_shot

    header = read_header(arguments.model)
    if arguments.shot is None and header.trade is None:
        raise UsageError(
            f"{arguments.model} was not measured yet, so there is no view to calibrate on; give a --shot, or measure "
            "the model with 'chona trade'"
        )
    device = resolve_device(arguments.device)
    from chona_model.bake import check_actors, choose_frames
    from chona_model.model_store import load_actor
    from chona_model.sight import shown_identities
    from chona_model.trade.estimate import estimate, reference_shot

    progress.check()
    progress.start("estimate", arguments.seconds, unit="s")
    names = header.skeleton.names
    shot = reference_shot(header.trade or {}, names) if arguments.shot is None else read_shot(arguments.shot)
    check_actors(shot, header)
    frames = choose_frames(shot, arguments.frames)
    persons, objects = shown_identities(shot)
    actor = load_actor(arguments.model, device, persons, objects)
    found = estimate(actor, shot, frames, header.trade, arguments.preset, arguments.seconds)
    lines = [
        f"{name}: {'' if each.psnr is None else f'{each.psnr:.1f} dB, '}{each.seconds_per_frame:.2f} s a frame here; "
        f"{found.frames} frame{'s' * (found.frames > 1)} ≈ {each.total_seconds:.0f} s"
        for name, each in found.presets.items()
    ]
    return _finish(progress, "\n".join(lines), **found.as_dict())


def _serve(arguments: argparse.Namespace, _progress: Progress) -> int:
    from chona_model.formats.model_file import read_header

    read_header(arguments.model)
    device = resolve_device(arguments.device)
    from chona_model.serve import serve

    frames = sys.stdout.buffer
    # Libraries print where they like; stdout belongs to the frames.
    with contextlib.redirect_stdout(sys.stderr):
        serve(arguments.model, device, sys.stdin.buffer, frames)
    return DONE


def _finish(progress: Progress, words: str, **fields: Any) -> int:
    """Ends a long command as the job left it: the job may have reported its end itself."""
    if progress.ended is None and progress.cancelled_by_user:
        progress.cancelled(**fields)
    if progress.ended is None:
        progress.result(**fields)
    if progress.ended != "result":
        return FAILED
    if progress.mode == "terminal":
        sys.stdout.write(words + "\n")
    return DONE


def _open(arguments: argparse.Namespace) -> tuple[Dataset, str]:
    """The joined captures, and in words what they are."""
    from chona_model.data.opener import join_datasets, open_dataset

    datasets, words = [], []
    for source in sources_of(arguments.sources):
        dataset = open_dataset(
            source.data, source.format, sequences=source.sequences, split=source.split,
            body_model_dir=arguments.body_model,
        )  # fmt: skip
        names = list(dict.fromkeys(view.sequence for view in dataset.views))
        more = f" and {len(names) - NAMED_SEQUENCES} more" if len(names) > NAMED_SEQUENCES else ""
        folder = source.data.resolve().name
        words.append(f"{folder}: {', '.join(names[:NAMED_SEQUENCES])}{more} ({len(dataset.views)} views)")
        datasets.append(dataset)
    return (join_datasets(datasets) if len(datasets) > 1 else datasets[0]), "; ".join(words)


def resolve_device(asked: str) -> str:
    """``cpu`` or ``cuda`` of ``auto``, ``cpu`` or ``cuda``.

    Raises:
        UsageError: CUDA was asked for and is not there.
    """
    if asked == "cpu":
        return "cpu"
    import torch

    if torch.cuda.is_available():
        return "cuda"
    if asked == "cuda":
        build = "has no driver or no card" if torch.version.cuda else "has a torch without CUDA"
        raise UsageError(f"--device is cuda, but this computer {build}; use --device cpu, or see 'chona doctor'")
    return "cpu"


def _info(arguments: argparse.Namespace, _progress: Progress) -> int:
    from chona_model.info import describe, to_text

    description = describe(arguments.file)
    sys.stdout.write(json.dumps(description, indent=2) + "\n" if arguments.json else to_text(description))
    return DONE


def _check_data(arguments: argparse.Namespace, _progress: Progress) -> int:
    from chona_model.data.checks import check_data
    from chona_model.data.opener import open_dataset
    from chona_model.data_report import to_json, to_text

    if arguments.out is not None:
        writable_folder(arguments.out, "--out")
    if arguments.json is not None:
        writable_file(arguments.json, "--json")
    dataset = open_dataset(arguments.data, arguments.format, body_model_dir=arguments.body_model)
    report = check_data(dataset, arguments.out)
    if arguments.json is not None:
        from chona_model.formats.atomic import write_bytes

        write_bytes(arguments.json, to_json(report).encode())
    sys.stdout.write(to_text(report))
    # Gaps are ordinary; whatever else is warned of means that the data are damaged or misread.
    return DONE if len(report.warnings) <= len(report.gaps) else FAILED


def _doctor(arguments: argparse.Namespace, _progress: Progress) -> int:
    from chona_model.doctor import examine, to_text

    report = examine()
    sys.stdout.write(json.dumps(report, indent=2) + "\n" if arguments.json else to_text(report))
    return DONE if report["ok"] else FAILED


def _demo(arguments: argparse.Namespace, _progress: Progress) -> int:
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


if __name__ == "__main__":
    sys.exit(main())

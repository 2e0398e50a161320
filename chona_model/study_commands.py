"""Commands that came with the study: ``chona reproduce`` and ``chona add``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from chona_model.arguments import UsageError, sources_of, writable_folder
from chona_model.command_parts import finish, open_sources, resolve_device, with_others
from chona_model.study_line import ADD_STEPS, DEFAULT_MINUTES

if TYPE_CHECKING:
    from chona_model.progress import Progress

DRY_STEPS, DRY_FRAMES, DRY_SCALE = 10, 2, 0.25


def reproduce_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Makes a table of the paper again."""
    from chona_model.presets import find_preset
    from chona_model.reproduce.cell import Protocol
    from chona_model.reproduce.run import Reproduction, reproduce
    from chona_model.reproduce.tables import cells_of

    cells_of(arguments.table, arguments.rows, arguments.columns)
    find_preset(arguments.quality)
    if not arguments.data.is_dir():
        raise UsageError(f"--data is {arguments.data}, which is no folder; expected the one that holds the data sets")
    out = writable_folder(arguments.out, "--out")
    dry = arguments.dry_run
    steps = DRY_STEPS if dry and arguments.steps is None and arguments.minutes is None else arguments.steps
    minutes = arguments.minutes if arguments.minutes is not None or steps is not None else DEFAULT_MINUTES
    protocol = Protocol(
        minutes, steps, arguments.image_scale or (DRY_SCALE if dry else 1.0), arguments.preset, arguments.quality,
        arguments.seed, DRY_FRAMES if dry else None,
    )  # fmt: skip
    devices = tuple(arguments.devices or (arguments.device,))
    if len(devices) == 1:
        devices = (resolve_device(devices[0]),)
    task = Reproduction(
        arguments.table, arguments.data, out, arguments.rows, arguments.columns, arguments.body_model, devices
    )
    told = reproduce(task, protocol, progress, _again(arguments, protocol))
    return finish(progress, f"{told['cells']} of {told['of']} cells made, {told['kept']} kept: {told['table']}", **told)


def add_command(arguments: argparse.Namespace, progress: Progress) -> int:
    """Adds identities to a model."""
    from chona_model.formats.model_file import read_header

    sources_of(arguments.sources)
    names = _new_names(arguments.identity)
    with with_others(progress) as writes:
        header = read_header(arguments.model)
        out = writable_folder(arguments.out, "--out") if writes else arguments.out
        dataset, statement = open_sources(arguments)
        progress.check()
        device = resolve_device(arguments.device)
        from chona_model.train.add import add
        from chona_model.train.run import TrainRun

        steps = arguments.steps if arguments.steps is not None or arguments.minutes is not None else ADD_STEPS
        run = TrainRun(
            method=header.method, minutes=arguments.minutes, steps=steps, image_scale=arguments.image_scale,
            device=device, seed=arguments.seed, resume=arguments.resume, data_statement=statement,
            preview_every=arguments.preview_every,
        )  # fmt: skip
        model = add(arguments.model, dataset, names, out, run, progress)
    return finish(progress, f"wrote {model} with {', '.join(names.values())} added", model=str(model))


def _new_names(words: Sequence[str]) -> dict[str, str]:
    """Names in the model by names in the data, of ``NAME`` and ``NAME=NEW``."""
    names: dict[str, str] = {}
    for word in words:
        name, equals, new = word.partition("=")
        if not name or (equals and not new):
            raise UsageError(f"--identity has '{word}', expected NAME or NAME=NEW: name both sides")
        if name in names or (new or name) in names.values():
            raise UsageError(f"--identity has '{word}' a second time, or two by one name; give each a name of its own")
        names[name] = new or name
    return names


def _again(arguments: argparse.Namespace, protocol: object) -> list[str]:
    """The command's own words, without rows, columns and devices: for processes of single cells."""
    words = ["reproduce", arguments.table, "--data", str(arguments.data), "--out", str(arguments.out)]
    for name in ("minutes", "steps", "image_scale", "preset", "quality", "seed", "body_model"):
        value = getattr(protocol, name, None) if name != "body_model" else arguments.body_model
        if value is not None:
            words += [f"--{name.replace('_', '-')}", f"{value}"]
    return [*words, *(["--dry-run"] if arguments.dry_run else [])]

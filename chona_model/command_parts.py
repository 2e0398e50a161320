"""What commands share: opening what ``--data`` names, choosing a device, reporting the end."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from chona_model.arguments import UsageError, sources_of
from chona_model.progress import Progress

if TYPE_CHECKING:
    from chona_model.data.dataset import Dataset

DONE, FAILED = 0, 1
NAMED_SEQUENCES = 20
"""So many sequences are named in a model's statement of its training data; of more, the number."""


def finish(progress: Progress, words: str, **fields: Any) -> int:
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


def open_sources(arguments: argparse.Namespace) -> tuple[Dataset, str]:
    """The joined captures, and in words what they are."""
    from chona_model.data.opener import join_datasets, open_dataset

    datasets, words = [], []
    for source in sources_of(arguments.sources):
        dataset = open_dataset(
            source.data, source.format, sequences=source.sequences, split=source.split,
            body_model_dir=arguments.body_model, cameras=source.cameras, object_size=source.object_size,
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

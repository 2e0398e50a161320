"""What commands share: opening what ``--data`` names, choosing a device, reporting the end."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from chona_model.arguments import UsageError, sources_of
from chona_model.launch import read_launch
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
        # torchrun starts what has failed anew, and the user wanted an end.
        return DONE if progress.ended == "cancelled" and read_launch().attempts_left else FAILED
    if progress.mode == "terminal" and not progress.quiet:
        sys.stdout.write(words + "\n")
    return DONE


@contextmanager
def with_others(progress: Progress) -> Iterator[bool]:
    """Joins the processes that torchrun has started beside this one, where it has, while the block runs.

    Yields:
        whether this process is the one that writes.
    """
    launch = read_launch()
    if launch.size == 1:
        yield True
        return
    from chona_model.train.joining import joined

    with joined(progress):
        yield launch.rank == 0


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
    """``cpu`` or ``cuda`` of ``auto``, ``cpu`` or ``cuda``; ``cuda:N`` where processes share a computer's cards.

    Raises:
        UsageError: CUDA was asked for and is not there, or not for every process.
    """
    if asked == "cpu":
        return "cpu"
    import torch

    if torch.cuda.is_available():
        return _own_card(torch.cuda.device_count())
    if asked == "cuda":
        build = "has no driver or no card" if torch.version.cuda else "has a torch without CUDA"
        raise UsageError(f"--device is cuda, but this computer {build}; use --device cpu, or see 'chona doctor'")
    return "cpu"


def _own_card(cards: int) -> str:
    """``cuda``, or of several processes on this computer the card that is this one's."""
    launch = read_launch()
    if launch.local_size == 1:
        return "cuda"
    if launch.local_size > cards:
        raise UsageError(
            f"torchrun has started {launch.local_size} processes on a computer with {cards} graphics "
            f"card{'s' * (cards > 1)}; give --nproc-per-node {cards}, or --device cpu"
        )
    import torch

    torch.cuda.set_device(launch.local_rank)  # what is made on "cuda" alone belongs there too
    return f"cuda:{launch.local_rank}"

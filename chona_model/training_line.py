"""Options that every command with a training in it shares; see ``command_line.py``."""

from __future__ import annotations

import argparse

from chona_model.arguments import number, whole

MAX_SEED = 2**63 - 1
_MOST_STEPS = 10**9


def add_training(command: argparse.ArgumentParser, steps: str) -> None:
    """How long, from which seed, from the start or not, with which pictures.

    Args:
        steps: words of ``--steps``.
    """
    add_length(command, "how long to train", steps)
    command.add_argument("--seed", type=whole(0, MAX_SEED), default=0, metavar="N", help="of all random numbers")
    command.add_argument("--resume", action="store_true", help="continue from the checkpoint in RUN")
    command.add_argument(
        "--preview-every", type=number(0, above=True), metavar="S",
        help="draw RUN/preview.png, a training view beside the model's, every S seconds (default: never)",
    )  # fmt: skip


def add_length(command: argparse.ArgumentParser, minutes: str, steps: str) -> None:
    """``--minutes`` or ``--steps``, in these words."""
    length = command.add_mutually_exclusive_group()
    length.add_argument("--minutes", type=number(0, above=True), metavar="M", help=minutes)
    length.add_argument("--steps", type=whole(1, _MOST_STEPS), metavar="N", help=steps)

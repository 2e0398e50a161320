"""Options of the study's commands; see ``command_line.py``."""

from __future__ import annotations

import argparse
from pathlib import Path

from chona_model.arguments import name_list, number, whole
from chona_model.training_line import MAX_SEED, add_length, add_training

DEFAULT_MINUTES = 10.0
"""Of training a cell."""
ADD_STEPS = 1500
"""Of ``chona add``."""


def add_add(command: argparse.ArgumentParser) -> None:
    """Options of ``chona add``, besides those that name the data."""
    command.add_argument("--model", type=Path, required=True, metavar="FILE", help="the model that it is added to")
    command.add_argument(
        "--identity", type=name_list, required=True, metavar="A,B=C,…",
        help="persons and objects of the data, seen alone or with each other; B=C adds B by the name C",
    )  # fmt: skip
    command.add_argument("--out", type=Path, required=True, metavar="RUN", help="folder for the new model and its log")
    add_training(command, steps=f"default: {ADD_STEPS}")


def add_reproduce(command: argparse.ArgumentParser) -> None:
    """Options of ``chona reproduce``."""
    command.add_argument("table", metavar="TABLE", help="novel-pose, boxes, compositional, static-object, novel-person")
    command.add_argument("--data", type=Path, required=True, metavar="DIR", help="holds behave, zju_mocap and co3d")
    command.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for cells, tables and pictures")
    add_length(command, f"to train a cell (default: {DEFAULT_MINUTES:g})", "to train a cell, in place of minutes")
    command.add_argument("--image-scale", type=number(0, 1, above=True), metavar="S", help="default: 1")
    command.add_argument("--preset", choices=("fast", "paper"), default="fast", help="of training (default: fast)")
    command.add_argument("--quality", default="final", metavar="P", help="of rendering (default: final)")
    command.add_argument("--rows", type=name_list, metavar="A,B,…", help="methods (default: all that there are)")
    command.add_argument("--columns", type=name_list, metavar="A,B,…", help="default: all")
    command.add_argument("--seed", type=whole(0, MAX_SEED), default=0, metavar="N")
    command.add_argument(
        "--devices", type=name_list, metavar="cuda:0,…", help="a cell on each at a time (default: --device)"
    )
    command.add_argument("--dry-run", action="store_true", help="two frames, few steps: whether all of it runs")
    command.add_argument("--body-model", type=Path, metavar="DIR", help="SMPL-H files, as for train")

"""Checkpoints: tensors in safetensors with the run's position and settings in the metadata."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from chona_model.formats.model_file import ModelFileError, read_metadata
from chona_model.formats.tensor_file import write_tensors
from chona_model.plain_json import JsonError, convert, parse, shortened
from chona_model.train.guard import GuardState

NAME = "checkpoint.safetensors"

LONGEST = 200
"""Characters that a message gives to one setting: a run may have hundreds of sequences."""


MOST_STEPS = 1 << 40
MOST_SECONDS = 1e10


class CheckpointError(ValueError):
    """A checkpoint that cannot be continued."""


class Position(msgspec.Struct, forbid_unknown_fields=True):
    """How far a run has come: steps, seconds, what its guard remembers, and the job (see ``launch``) that made them."""

    step: int
    seconds: float
    guard: GuardState = msgspec.field(default_factory=GuardState)
    job: str = ""

    def __post_init__(self) -> None:
        if not (0 <= self.step <= MOST_STEPS and 0.0 <= self.seconds <= MOST_SECONDS):
            raise ValueError(f"step {self.step} after {self.seconds} s is no position")


def save_checkpoint(run: Path, state: dict[str, Tensor], position: dict[str, Any], settings: dict[str, Any]) -> None:
    """Writes ``RUN/checkpoint.safetensors``, whole or not at all."""
    write_tensors(run / NAME, state, {"position": json.dumps(position), "settings": json.dumps(settings)})


def load_checkpoint(run: Path, settings: dict[str, Any]) -> tuple[dict[str, Tensor], Position]:
    """Reads a checkpoint of the same settings.

    Returns:
        the trainer's state and the position.

    Raises:
        CheckpointError: none there, damaged, or of another run.
    """
    path = run / NAME
    with refused(path):
        metadata = read_metadata(path)
        saved = convert(parse(metadata["settings"]), dict[str, Any])
        position = convert(parse(metadata["position"]), Position)
        state = load_file(path)
    differing = sorted(key for key in settings if saved.get(key) != settings[key])
    if differing:
        told = "; ".join(f"{key} was {_short(saved.get(key))}, is {_short(settings[key])}" for key in differing)
        raise CheckpointError(
            f"{path} belongs to a run with other settings ({told}); give the same ones, or train without --resume"
        )
    return state, position


def saved_by(run: Path) -> str:
    """The job (see ``launch``) that wrote the checkpoint; empty where there is none, or a damaged one."""
    try:
        return convert(parse(read_metadata(run / NAME)["position"]), Position).job
    except (ModelFileError, KeyError, JsonError):
        return ""


@contextmanager
def refused(path: Path) -> Iterator[None]:
    """``CheckpointError`` for whatever a damaged checkpoint leads to while it is read, or given to a trainer."""
    try:
        yield
    except (ModelFileError, SafetensorError, JsonError, LookupError, ValueError, TypeError, RuntimeError) as error:
        raise CheckpointError(
            f"cannot continue from {path}: {shortened(error)}; train without --resume to start anew"
        ) from error


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"

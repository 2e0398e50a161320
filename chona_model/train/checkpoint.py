"""Checkpoints: tensors in safetensors with the run's position and settings in the metadata."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from chona_model.formats.model_file import ModelFileError, read_metadata
from chona_model.formats.tensor_file import write_tensors

NAME = "checkpoint.safetensors"

LONGEST = 200
"""Characters that a message gives to one setting: a run may have hundreds of sequences."""


class CheckpointError(ValueError):
    """A checkpoint that cannot be continued."""


def save_checkpoint(run: Path, state: dict[str, Tensor], position: dict[str, Any], settings: dict[str, Any]) -> None:
    """Writes ``RUN/checkpoint.safetensors``, whole or not at all."""
    write_tensors(run / NAME, state, {"position": json.dumps(position), "settings": json.dumps(settings)})


def load_checkpoint(run: Path, settings: dict[str, Any]) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Reads a checkpoint of the same settings.

    Returns:
        the trainer's state and the position (``step``, ``seconds``).

    Raises:
        CheckpointError: none there, damaged, or of another run.
    """
    path = run / NAME
    try:
        metadata = read_metadata(path)
        saved = json.loads(metadata["settings"])
        state, position = load_file(path), json.loads(metadata["position"])
    except (ModelFileError, SafetensorError, KeyError, ValueError) as error:
        raise CheckpointError(f"cannot continue from {path}: {error}; train without --resume to start anew") from error
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
        return str(json.loads(read_metadata(run / NAME)["position"]).get("job", ""))
    except (ModelFileError, KeyError, ValueError):
        return ""


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"

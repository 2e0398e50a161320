"""What readers of captures share: which frames are wanted, what was skipped in words, fits that can be used."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from chona_model.data.dataset import DatasetError
from chona_model.plain_json import JsonError, parse, read_text, shortened

LARGEST_FIT = 1e5
"""Metres, radians or betas of a fit: beyond, it is no more use than a NaN."""


def chosen_frames(
    present: Collection[str], asked: Iterable[str] | None, kind: str, place: Path
) -> dict[str, frozenset[str] | None]:
    """Wanted frames by sequence, in the order in which they are named; None stands for all.

    Args:
        present: names of the sequences that there are.
        asked: names, or ``SEQUENCE/FRAME`` for single frames; all when None.
        kind, place: what a sequence is called and where they lie, for the message.

    Raises:
        DatasetError: a sequence is asked for that is not there.
    """
    if asked is None:
        return dict.fromkeys(present)
    chosen: dict[str, frozenset[str] | None] = {}
    for entry in asked:
        name, _, frame = entry.partition("/")
        if name not in present:
            raise DatasetError(f"there is no {kind} '{name}' in {place}; it has {', '.join(present) or 'none'}")
        before = chosen.get(name, frozenset())
        chosen[name] = None if not frame or before is None else before | {frame}
    return chosen


def real_numbers(values: object) -> np.ndarray:
    """Values as float64.

    Raises:
        ValueError: text, complex numbers whose second half would be dropped, rows of different lengths. In few words,
            where numpy would repeat what it was given.
        TypeError: anything else that is no number.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in "cSU":
            raise ValueError(f"numbers of the type {array.dtype} are no real numbers")
        return array.astype(np.float64)
    except ValueError as error:
        raise ValueError(shortened(error)) from error


def counted(gaps: Mapping[str, int]) -> str:
    """What was skipped, as in ``2 x image, 1 x person mask``."""
    return ", ".join(f"{count} x {kind}" for kind, count in sorted(gaps.items())) or "no frames at all"


def is_usable(fit: Mapping[str, np.ndarray], vectors: Collection[str], path: Path) -> bool:
    """Whether a fit's arrays, each of one dimension, are finite and of a size that a fit can have.

    Args:
        vectors: names of those that have three numbers.
        path: where they come from, for the message.

    Raises:
        DatasetError: a vector has another number of them.
    """
    wrong = next((name for name in fit if name in vectors and fit[name].size != 3), None)
    if wrong is not None:
        raise DatasetError(f"{path}: {wrong} has {fit[wrong].size} numbers, expected 3")
    return all(bool((np.abs(array) <= LARGEST_FIT).all()) for array in fit.values())


def json_object(path: Path, content: str) -> dict[str, Any]:
    """A file's JSON, which must be an object; ``content`` says of what, for the message.

    Raises:
        DatasetError: it cannot be read, or holds something else.
    """
    try:
        parsed = parse(read_text(path))
    except (OSError, JsonError) as error:
        raise DatasetError(f"cannot read {path}: {error}; expected {content}") from error
    if not isinstance(parsed, dict):
        raise DatasetError(f"{path} holds a {type(parsed).__name__}, expected an object with {content}")
    return parsed

"""Opens a capture of any known layout, and joins several into one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from chona_model.data.behave import data_root, read_behave
from chona_model.data.blender_capture import read_blender_capture
from chona_model.data.dataset import Dataset, DatasetError, ObjectShape, Person
from chona_model.data.splits import read_split

FORMATS = ("behave", "blender")
LATER_FORMATS = ("zju_mocap", "co3d", "transforms")
"""Named on the command line; their readers are not part of this version."""

SAME_BODY = 0.02
"""Metres that the joints of one person may differ between captures (fits of other frames have other mean shapes)."""


def open_dataset(
    root: Path,
    format: str = "auto",
    *,
    sequences: Sequence[str] | None = None,
    split: str | None = None,
    body_model_dir: Path | None = None,
) -> Dataset:
    """Reads a capture.

    Args:
        root: its folder.
        format: ``behave``, ``blender``, or ``auto`` to guess by what lies in the folder.
        sequences: names, or ``SEQUENCE/FRAME``; all when None.
        split: ``FILE:KEY`` instead of ``sequences``; a FILE that does not exist is looked up in ``root`` and beside it.
        body_model_dir: SMPL-H files for readers that need them.

    Raises:
        DatasetError: what was found, what was expected, what to do.
    """
    if not root.is_dir():
        raise DatasetError(f"there is no folder {root}; expected one with a capture")
    if sequences is not None and split is not None:
        raise DatasetError("both sequences and a split are given; name the views by one of the two")
    kind = _guess(root) if format == "auto" else format
    if kind in LATER_FORMATS:
        raise DatasetError(f"the reader of '{kind}' is not part of this version; it reads {' and '.join(FORMATS)}")
    if kind not in FORMATS:
        raise DatasetError(f"the format is '{kind}', expected one of auto, {', '.join((*FORMATS, *LATER_FORMATS))}")
    if split is not None:
        sequences = read_split(_located(split, root))
    if sequences is not None and not sequences:
        raise DatasetError("the list of sequences is empty; name at least one, or none of this to use all")
    if kind == "behave":
        return read_behave(root, sequences, body_model_dir)
    return read_blender_capture(root, sequences)


def _guess(root: Path) -> str:
    if (root / "capture.json").is_file():
        return "blender"
    try:
        data_root(root)
        return "behave"
    except DatasetError:
        pass
    for kind, pattern in (
        ("zju_mocap", "annots.npy"),
        ("transforms", "transforms*.json"),
        ("co3d", "*annotations.jgz"),
    ):
        if any(root.glob(pattern)) or any(root.glob(f"*/{pattern}")):
            return kind
    raise DatasetError(
        f"{root} is no capture of a known layout; tried blender (capture.json), behave (sequences/*/info.json), "
        "zju_mocap (annots.npy), transforms (transforms*.json), co3d (*annotations.jgz): name the folder "
        "that holds one of these"
    )


def _located(split: str, root: Path) -> str:
    file, colon, key = split.rpartition(":")
    for folder in (Path(), root, root.parent):
        if file and (folder / file).is_file():
            return f"{folder / file}{colon}{key}"
    return split


def join_datasets(datasets: Sequence[Dataset]) -> Dataset:
    """One dataset of several, for joint training.

    Raises:
        DatasetError: skeletons differ, or an identity of the same name has another shape.
    """
    if not datasets:
        raise DatasetError("there is no dataset to join; name at least one with --data")
    first = datasets[0]
    persons: dict[str, Person] = {}
    objects: dict[str, ObjectShape] = {}
    gaps: Counter[str] = Counter()
    for dataset in datasets:
        if dataset.skeleton != first.skeleton:
            raise DatasetError(
                f"the captures have different skeletons ({len(first.skeleton)} and {len(dataset.skeleton)} bones, or "
                "other names); train them apart, or capture them with one rig"
            )
        for name, person in dataset.persons.items():
            if not np.allclose(persons.setdefault(name, person).rest_joints, person.rest_joints, atol=SAME_BODY):
                raise DatasetError(f"two captures have a person '{name}' of different build; rename one of them")
        for name, shape in dataset.objects.items():
            known = objects.setdefault(name, shape)
            if not (np.allclose(known.lower, shape.lower) and np.allclose(known.upper, shape.upper)):
                raise DatasetError(f"two captures have an object '{name}' of different size; rename one of them")
        gaps += dataset.gaps
    views = tuple(view for dataset in datasets for view in dataset.views)
    labels = Counter(view.label for view in views)
    doubled = next((label for label, count in labels.items() if count > 1), None)
    if doubled is not None:
        raise DatasetError(f"the view {doubled} is in two of the captures; name each sequence once")
    return Dataset(first.skeleton, persons, objects, views, gaps)

"""Opens a capture of any known layout, and joins several into one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from chona_model.data.behave import data_root, read_behave
from chona_model.data.blender_capture import read_blender_capture
from chona_model.data.co3d import category_folders, read_co3d
from chona_model.data.dataset import Dataset, DatasetError, ObjectShape, Person
from chona_model.data.splits import read_split
from chona_model.data.transforms import PATTERN, read_transforms
from chona_model.data.zju_mocap import read_zju_mocap, subject_folders

FORMATS = ("behave", "zju_mocap", "co3d", "transforms", "blender")
SCANS = ("co3d", "transforms")
"""Formats of static objects without a scale of their own."""

SAME_BODY = 0.02
"""Metres that the joints of one person may differ between captures (fits of other frames have other mean shapes)."""


def open_dataset(
    root: Path,
    format: str = "auto",
    *,
    sequences: Sequence[str] | None = None,
    split: str | None = None,
    body_model_dir: Path | None = None,
    cameras: Sequence[str] | None = None,
    object_size: float | None = None,
) -> Dataset:
    """Reads a capture.

    Args:
        root: its folder.
        format: one of ``FORMATS``, or ``auto`` to guess by what lies in the folder.
        sequences: names, or ``SEQUENCE/FRAME``; all when None.
        split: ``FILE:KEY`` instead of ``sequences``; a FILE that does not exist is looked up in ``root`` and beside it.
        body_model_dir: SMPL-H files for readers that need them.
        cameras: names of the cameras to use; all when None.
        object_size: metres of the longest side of scanned objects (CO3D, transforms), whose scale is arbitrary.

    Raises:
        DatasetError: what was found, what was expected, what to do.
    """
    if not root.is_dir():
        raise DatasetError(f"there is no folder {root}; expected one with a capture")
    if sequences is not None and split is not None:
        raise DatasetError("both sequences and a split are given; name the views by one of the two")
    kind = guess_format(root) if format == "auto" else format
    if kind not in FORMATS:
        raise DatasetError(f"the format is '{kind}', expected one of auto, {', '.join(FORMATS)}")
    if object_size is not None and kind not in SCANS:
        raise DatasetError(f"an object's size is given for a capture of kind {kind}, whose objects have their own size")
    if split is not None:
        sequences = read_split(_located(split, root))
    if sequences is not None and not sequences:
        raise DatasetError("the list of sequences is empty; name at least one, or none of this to use all")
    match kind:
        case "behave":
            dataset = read_behave(root, sequences, body_model_dir)
        case "zju_mocap":
            return read_zju_mocap(root, sequences, body_model_dir, cameras)
        case "co3d":
            dataset = read_co3d(root, sequences, object_size)
        case "transforms":
            dataset = read_transforms(root, sequences, object_size)
        case _:
            dataset = read_blender_capture(root, sequences)
    return dataset if cameras is None else _seen_by(dataset, cameras)


def _seen_by(dataset: Dataset, cameras: Sequence[str]) -> Dataset:
    """Views of some cameras alone."""
    known = list(dict.fromkeys(view.camera_name for view in dataset.views))
    unknown = next((name for name in cameras if name not in known), None)
    if unknown is not None:
        raise DatasetError(f"there is no camera '{unknown}' in the capture; it has {', '.join(known)}")
    return replace(dataset, views=tuple(view for view in dataset.views if view.camera_name in cameras))


def guess_format(root: Path) -> str:
    """The layout of a capture, by what lies in its folder.

    Raises:
        DatasetError: nothing that is known lies there.
    """
    if (root / "capture.json").is_file():
        return "blender"
    try:
        data_root(root)
        return "behave"
    except DatasetError:
        pass
    if subject_folders(root):
        return "zju_mocap"
    if category_folders(root):
        return "co3d"
    if any(root.glob(PATTERN)) or any(root.glob(f"*/{PATTERN}")):
        return "transforms"
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
    first = next((dataset for dataset in datasets if dataset.persons), datasets[0])
    persons: dict[str, Person] = {}
    objects: dict[str, ObjectShape] = {}
    gaps: Counter[str] = Counter()
    for dataset in datasets:
        if dataset.persons and dataset.skeleton != first.skeleton:
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

"""What readers share: which frames are wanted, and which fits can be used."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from chona_model.data.dataset import DatasetError
from chona_model.data.reading import LARGEST_FIT, chosen_frames, counted, is_usable, real_numbers

THERE = ("walk", "lift", "sit")


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        (None, {"walk": None, "lift": None, "sit": None}),
        (["sit", "walk"], {"sit": None, "walk": None}),
        (["lift/0003", "lift/0001", "lift/0003"], {"lift": frozenset({"0001", "0003"})}),
        (["lift/0003", "lift"], {"lift": None}),
        (["lift", "lift/0003"], {"lift": None}),
        (["lift/"], {"lift": None}),
    ],
)
def test_frames_are_chosen_alone_or_with_their_whole_sequence(
    asked: list[str] | None, expected: dict[str, frozenset[str] | None]
) -> None:
    chosen = chosen_frames(THERE, asked, "sequence", Path("capture"))
    assert list(chosen.items()) == list(expected.items())


@pytest.mark.parametrize(("present", "listed"), [(THERE, "walk, lift, sit"), ((), "none")])
def test_an_unknown_sequence_is_named_with_those_there_are(present: tuple[str, ...], listed: str) -> None:
    with pytest.raises(DatasetError) as told:
        chosen_frames(present, ["walk"] * len(present) + ["run/0001"], "scan", Path("capture"))
    assert str(told.value) == f"there is no scan 'run' in capture; it has {listed}"


def test_what_was_skipped_in_words() -> None:
    assert counted(Counter({"person mask": 1, "image": 2})) == "2 x image, 1 x person mask"
    assert counted(Counter()) == "no frames at all"


def test_a_fit_is_finite_and_not_out_of_this_world() -> None:
    fit = {"pose": np.zeros(72), "trans": np.array([LARGEST_FIT, 0.0, 0.0])}
    assert is_usable(fit, ("angle", "trans"), Path("fit.pkl"))
    assert not is_usable(fit | {"pose": np.array([0.0, np.nan])}, ("trans",), Path("fit.pkl"))
    assert not is_usable(fit | {"pose": np.array([-1.1 * LARGEST_FIT])}, ("trans",), Path("fit.pkl"))
    with pytest.raises(DatasetError, match=r"^fit\.pkl: pose has 72 numbers, expected 3$"):
        is_usable(fit, ("pose",), Path("fit.pkl"))


def test_only_real_numbers_are_numbers() -> None:
    assert real_numbers([[1, 2.5], [True, np.float32(0.5)]]).tolist() == [[1.0, 2.5], [1.0, 0.5]]
    assert real_numbers(np.array([1.5, 2], dtype=object)).dtype == np.float64
    with pytest.raises(ValueError, match="complex128 are no real numbers"):
        real_numbers(np.array([1.0 + 2.0j]))
    with pytest.raises(ValueError, match="are no real numbers") as told:
        real_numbers(["x" * 70_000])
    assert len(str(told.value)) < 400
    with pytest.raises(ValueError, match="inhomogeneous"):
        real_numbers([[1.0], [1.0, 2.0]])
    with pytest.raises(TypeError):
        real_numbers([{}])

"""Curves and pictures of the Train panel, pixel by pixel."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from operation_helpers import bpy_pythons, run_bpy
from PIL import Image

pytestmark = pytest.mark.bpy
LEFT, TOP, RIGHT, BOTTOM = 50, 8, 8, 18
WIDTH, HALF = 200, 80
EIGHT_BITS = 1.0 / 255.0
"""Icons are stored so."""
BLUE, ORANGE, WHITE = (0.35, 0.68, 1.0), (1.0, 0.62, 0.22), (1.0, 1.0, 1.0)


@pytest.fixture(scope="module", params=bpy_pythons())
def drawn(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("pictures")
    logs = {
        "level": [{"step": step, "loss": 0.01, "psnr": 15.0, "empty_psnr": 9.0} for step in (1, 50, 100)],
        "rising": [{"step": step, "loss": 10 ** (-1 - step / 100), "psnr": 10 + step / 10} for step in range(101)],
        "previews": [
            {"step": step, "loss": 0.02, "psnr": 22.0, "preview_psnr": 12.0 + step / 20} for step in (1, 50, 100)
        ],
        "one": [{"step": 1, "loss": 0.5, "psnr": 3.0}],
        "empty": [],
    }
    for name, lines in logs.items():
        (folder / f"{name}.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    with (folder / "level.jsonl").open("a") as file:
        file.write('{"step": 120, "loss": NaN, "psnr": 1}\n[1]\nnonsense\n{"step": 140, "lo')
    colours = np.random.default_rng(2).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    Image.fromarray(colours).save(folder / "truth.png")
    return folder, run_bpy(request.param, "train_pictures.py", folder)


def rows_of(image: np.ndarray, colour: tuple, column: int) -> np.ndarray:
    """Rows of a colour in a column."""
    return np.flatnonzero(np.abs(image[:, column] - colour).max(axis=-1) < 1e-6)


def height(value: float, low: float, high: float) -> float:
    """Row of a value in a plot from ``low`` to ``high``."""
    return TOP + (high - value) / (high - low) * (HALF - TOP - BOTTOM - 1)


def test_whole_lines_are_read(drawn: tuple[Path, dict]) -> None:
    assert drawn[1]["lines"] == {"level": 3, "rising": 101, "previews": 3, "one": 1, "empty": 0}
    assert drawn[1]["missing"] == 0


def test_a_level_log_is_two_level_lines(drawn: tuple[Path, dict]) -> None:
    image = np.load(drawn[0] / "level.npy")
    assert image.shape == (2 * HALF, WIDTH, 3)
    first = LEFT + round(1 / 100 * (WIDTH - LEFT - RIGHT - 1))
    for column in (first, 120, WIDTH - RIGHT - 1):
        above, below = rows_of(image, BLUE, column), rows_of(image, ORANGE, column)
        # 15 dB is the lower end of a plot to 20, a hundredth that of one to a tenth.
        assert round(height(15.0, 15.0, 20.0)) in above and len(above) <= 2 + 12
        assert HALF + round(height(-2.0, -2.0, -1.0)) in below
    assert not len(rows_of(image, BLUE, first - 1)) and not len(rows_of(image, BLUE, WIDTH - RIGHT))


def test_a_rising_log_rises_by_its_scale(drawn: tuple[Path, dict]) -> None:
    image = np.load(drawn[0] / "rising.npy")
    dim = tuple(0.4 * part + 0.6 * 0.11 for part in BLUE)
    for step in (30, 50, 70):
        column = LEFT + round(step / 100 * (WIDTH - LEFT - RIGHT - 1))
        every, mean = rows_of(image[:HALF], dim, column), rows_of(image[:HALF], BLUE, column)
        assert abs(every.mean() - height(10 + step / 10, 10.0, 20.0)) <= 1.5
        lag = (1 - 0.15) / 0.15 * 0.1  # of a running mean behind a line, dB
        assert abs(mean.min() - height(10 + step / 10 - lag, 10.0, 20.0)) <= 1.5
        falling = rows_of(image[HALF:], ORANGE, column)
        assert abs(falling.min() - height(-1 - step / 100 + lag / 10, -2.0, -1.0)) <= 1.5


def test_previews_have_a_line_of_their_own(drawn: tuple[Path, dict]) -> None:
    image = np.load(drawn[0] / "previews.npy")
    for step in (25, 75):
        column = LEFT + round(step / 100 * (WIDTH - LEFT - RIGHT - 1))
        white = rows_of(image[:HALF], WHITE, column)
        assert abs(white.mean() - 0.5 - height(12 + step / 20, 10.0, 25.0)) <= 1.5


def test_short_logs_are_drawn(drawn: tuple[Path, dict]) -> None:
    one, empty = (np.load(drawn[0] / f"{name}.npy") for name in ("one", "empty"))
    assert len(rows_of(one, BLUE, WIDTH - RIGHT - 1)) >= 1
    assert empty.shape == one.shape and np.isfinite(empty).all()


def test_pictures_are_read_as_they_are_stored(drawn: tuple[Path, dict]) -> None:
    folder, answer = drawn
    with Image.open(folder / "truth.png") as stored:
        truth = np.asarray(stored) / 255.0
    assert np.abs(np.load(folder / "truth.npy") - truth).max() < 1e-6
    composed = np.load(folder / "composed.npy")
    assert composed.shape == (100, 100, 3)
    # 40 x 30 in 100 x 55: scaled by 55 / 30, in the middle.
    part = composed[:55, 13:86]
    assert np.abs(part - truth[np.arange(55) * 30 // 55][:, np.arange(73) * 40 // 73]).max() < 1e-6
    assert np.abs(composed[:55, :13] - 0.11).max() < 1e-6
    assert answer["images"] == 0, "nothing is left in the file"


def test_icons_hold_pictures(drawn: tuple[Path, dict]) -> None:
    folder, answer = drawn
    shown, icon, shrunk = (np.load(folder / f"{name}.npy") for name in ("shown", "icon", "shrunk"))
    assert icon.shape == (30, 30, 3) and np.abs(icon[5:25] - shown).max() < EIGHT_BITS
    assert np.abs(icon[:5] - 0.11).max() < EIGHT_BITS
    assert shrunk.shape == (6, 10, 3)
    assert shrunk[1, 2] == pytest.approx(shown[3:6, 6:9].mean(axis=(0, 1)))
    assert answer["forgotten"] == [True, 0]


def test_the_selected_training_is_shown(drawn: tuple[Path, dict]) -> None:
    answer = drawn[1]
    assert answer["empty"] and answer["curves alone"] and answer["with a preview"] > 0.3 and answer["none chosen"]

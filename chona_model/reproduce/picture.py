"""Pictures of a table: what is there, and below it what each method makes of it, cut to the figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from chona_model.formats.atomic import atomic_path
from chona_model.reproduce.tables import Cell, Table

TILE = (256, 256)
CAPTION = 18
MARGIN = 0.1
"""Of the figure's size, left around it."""


@dataclass(frozen=True)
class _Tile:
    """A picture, None where it was not made, and what is written below it."""

    file: Path | None
    caption: str


def draw_row(path: Path, row: str, cells: Sequence[tuple[Cell, Path]], table: Table) -> None:
    """A picture of one row: for every test one view as it is, as the method makes it, and with identities exchanged.

    Args:
        cells: those that were made, with their folders.
    """
    columns = []
    for cell, folder in cells:
        for test in cell.column.tests:
            target = _shown(folder, test)
            if target is not None:
                others = sorted(target.parent.glob(target.name.replace("_TARGET", "_*")))
                kept = [target, *(each for each in others if each != target)]
                tiles = [_Tile(each, each.stem.rsplit("_", 1)[-1].lower()) for each in kept]
                columns.append((f"{table.rows[row].label}: {test}", tiles))
    _draw(path, columns)


def draw_table(path: Path, cells: Sequence[tuple[Cell, Path]], table: Table) -> None:
    """A picture of all rows: a column a test, the same view of it as it is and as every method makes it.

    Args:
        cells: those that were made, with their folders; where a row lacks one, its place stays empty.
    """
    columns = []
    rows = [row for row in table.rows if any(cell.row == row for cell, _ in cells)]
    for test, column_name in table.tests.items():
        folders = {cell.row: folder for cell, folder in cells if cell.column_name == column_name}
        target = next((shown for folder in folders.values() if (shown := _shown(folder, test))), None)
        if target is not None:
            name = target.name.replace("_TARGET", "_PREDICTION")
            made = {row: _images(folder, test) / name for row, folder in folders.items()}
            labels = {row: table.rows[row].label + ("" if row in made else ": not made") for row in rows}
            columns.append((test, [_Tile(target, "truth"), *(_Tile(made.get(row), labels[row]) for row in rows)]))
    _draw(path, columns)


def _images(folder: Path, test: str) -> Path:
    return folder / "images" / test.replace(" ", "-")


def _shown(folder: Path, test: str) -> Path | None:
    """The target of the view that is drawn: one from the middle, so that no method chooses its own."""
    targets = sorted(_images(folder, test).glob("*_TARGET.png"))
    return targets[len(targets) // 2] if targets else None


def _draw(path: Path, columns: Sequence[tuple[str, Sequence[_Tile]]]) -> None:
    """Writes the columns side by side; nothing where there are none."""
    if not columns:
        return
    width, tall = TILE
    height = max(len(tiles) for _, tiles in columns)
    sheet = Image.new("RGB", (width * len(columns), CAPTION + height * (tall + CAPTION)), "white")
    pen = ImageDraw.Draw(sheet)
    for number, (title, tiles) in enumerate(columns):
        pen.text((number * width + 4, 3), title, fill="black")
        assert tiles[0].file is not None
        box = _figure_box(tiles[0].file)
        for place, tile in enumerate(tiles):
            top = CAPTION + place * (tall + CAPTION)
            if tile.file is not None:
                with Image.open(tile.file) as image:
                    sheet.paste(image.convert("RGB").resize(TILE, Image.Resampling.LANCZOS, box), (number * width, top))
            pen.text((number * width + 4, top + tall + 3), tile.caption, fill="black")
    with atomic_path(path) as temporary:
        sheet.save(temporary, format="PNG")


def _figure_box(file: Path) -> tuple[float, float, float, float]:
    """A square around what is not black, inside the picture where it fits."""
    with Image.open(file) as image:
        shown = np.asarray(image.convert("RGB")).any(axis=2)
    rows, columns = np.nonzero(shown)
    if not len(rows):
        return 0.0, 0.0, float(shown.shape[1]), float(shown.shape[0])
    side = (1.0 + 2.0 * MARGIN) * max(np.ptp(rows), np.ptp(columns)) + 1.0
    box = []
    for values, length in ((columns, shown.shape[1]), (rows, shown.shape[0])):
        span = min(side, float(length))
        low = np.clip(0.5 * (values.min() + values.max() + 1) - 0.5 * span, 0.0, length - span)
        box.append((float(low), float(low + span)))
    return box[0][0], box[1][0], box[0][1], box[1][1]

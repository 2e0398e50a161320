"""Numbers and a few capital letters for pictures made of arrays, where no font can be had without a window."""

from __future__ import annotations

import numpy as np

_SHAPES = {
    "0": "###/#.#/#.#/#.#/###", "1": ".#./##./.#./.#./###", "2": "###/..#/###/#../###", "3": "###/..#/###/..#/###",
    "4": "#.#/#.#/###/..#/..#", "5": "###/#../###/..#/###", "6": "###/#../###/#.#/###", "7": "###/..#/..#/.#./.#.",
    "8": "###/#.#/###/#.#/###", "9": "###/#.#/###/..#/###", ".": ".../.../.../.../.#.", "-": ".../.../###/.../...",
    " ": ".../.../.../.../...", "B": "##./#.#/##./#.#/##.", "D": "##./#.#/#.#/#.#/##.", "E": "###/#../##./#../###",
    "L": "#../#../#../#../###", "N": "##./#.#/#.#/#.#/#.#", "O": "###/#.#/#.#/#.#/###", "P": "###/#.#/###/#../#..",
    "R": "###/#.#/##./#.#/#.#", "S": "###/#../###/..#/###", "T": "###/.#./.#./.#./.#.",
}  # fmt: skip
SCALE = 2
"""Pixels of a dot; a character is 3 x 5 dots and 4 dots from the next."""


def words_mask(text: str) -> np.ndarray:
    """[H, W] bool of a line of text; what has no shape stays blank."""
    blank = _SHAPES[" "]
    shapes = [np.array([[dot == "#" for dot in row] for row in _SHAPES.get(c, blank).split("/")]) for c in text]
    spaced = [np.pad(shape, ((0, 0), (0, 1))) for shape in shapes]
    return np.kron(np.concatenate(spaced, axis=1)[:, :-1], np.ones((SCALE, SCALE), dtype=bool))


def write(image: np.ndarray, text: str, place: tuple[int, int], colour: tuple, align: str = "left") -> None:
    """Draw text into [H, W, 3] with its left (or ``right``) end and its middle at ``place`` (column, row)."""
    mask = words_mask(text)
    height, width = mask.shape
    left = place[0] - (width if align == "right" else 0)
    top = place[1] - height // 2
    rows, columns = np.nonzero(mask)
    rows, columns = rows + top, columns + left
    inside = (rows >= 0) & (rows < image.shape[0]) & (columns >= 0) & (columns < image.shape[1])
    image[rows[inside], columns[inside]] = colour

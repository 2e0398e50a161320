"""What the paper's tables consist of: ``paper.json``, read and checked.

A *row* is a method, a *column* is what one model is trained on, a *test* what it is measured on: the paper's tables
give one figure of PSNR and one of SSIM for every row and test.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from chona_model.methods import METHODS, Method

FILE = Path(__file__).with_name("paper.json")


class TableError(ValueError):
    """What was asked of the tables cannot be made: the message says what there is."""


class Exchanged(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Identities that take over the tests' interactions, for pictures; an object's name may end with ``*``."""

    persons: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()


class Column(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What one model is trained and tested on.

    Attributes:
        train: ``FORMAT/SEQUENCE`` or ``FORMAT/SEQUENCE/FRAME``.
        tests: the same by the test's name.
        divided: key in the data's ``splits.json`` with frames by sequence, where training and test share a sequence
            whose frames are divided at random; a data set without that file is divided here.
        exchanged: who else acts in the tests' pictures.
    """

    train: tuple[str, ...]
    tests: dict[str, tuple[str, ...]]
    divided: str = ""
    exchanged: Exchanged = Exchanged()


class Row(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A method, as the paper calls it, with its figures: PSNR and SSIM by the test's name."""

    label: str
    paper: dict[str, tuple[float, float]]


class Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """One table of the paper; rows by the method's name."""

    title: str
    source: str
    columns: dict[str, Column]
    rows: dict[str, Row]

    @property
    def tests(self) -> dict[str, str]:
        """The column of every test, in the paper's order."""
        return {test: name for name, column in self.columns.items() for test in column.tests}


@dataclass(frozen=True)
class Cell:
    """One model to train, and what it is tested on."""

    table: str
    row: str
    column_name: str
    column: Column

    @property
    def method(self) -> Method:
        """Of the row."""
        return METHODS[self.row]

    @property
    def slug(self) -> str:
        """A folder's name."""
        return f"{self.row}-{self.column_name}"


def read_tables() -> Mapping[str, Table]:
    """Every table by its name on the command line."""
    return msgspec.json.decode(FILE.read_bytes(), type=dict[str, Table])


def find_table(name: str) -> Table:
    """One of the tables.

    Raises:
        TableError: there is none of that name.
    """
    tables = read_tables()
    if name not in tables:
        raise TableError(f"there is no table '{name}'; expected one of {', '.join(tables)}")
    return tables[name]


def cells_of(name: str, rows: tuple[str, ...] | None = None, columns: tuple[str, ...] | None = None) -> list[Cell]:
    """The cells to make, column by column; rows of methods that this version lacks are left out unless named.

    Raises:
        TableError: a row or column is named that the table has not, or whose method this version lacks.
    """
    table = find_table(name)
    for kind, asked, known in (("row", rows, table.rows), ("column", columns, table.columns)):
        unknown = next((each for each in asked or () if each not in known), None)
        if unknown is not None:
            raise TableError(f"the table {name} has no {kind} '{unknown}'; it has {', '.join(known)}")
    lacking = next((row for row in rows or () if row not in METHODS), None)
    if lacking is not None:
        raise TableError(f"the method '{lacking}' is not part of this version; it has {', '.join(METHODS)}")
    return [
        Cell(name, row, column_name, column)
        for column_name, column in table.columns.items()
        if columns is None or column_name in columns
        for row in (rows if rows is not None else [row for row in table.rows if row in METHODS])
    ]

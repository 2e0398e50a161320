"""``chona reproduce``: the cells of a table one after the other, or side by side on several devices."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from chona_model.formats.atomic import write_bytes
from chona_model.progress import Progress
from chona_model.reproduce.cell import Protocol, finished, make_cell
from chona_model.reproduce.picture import draw_row, draw_table
from chona_model.reproduce.report import write_report
from chona_model.reproduce.sources import open_cell
from chona_model.reproduce.tables import Cell, TableError, cells_of, find_table

CELLS = "cells"
POLL_SECONDS = 0.5


@dataclass(frozen=True)
class Reproduction:
    """What is made.

    Attributes:
        table: its name; rows, columns: some of them, all when None.
        data: the folder that holds the data sets; body_model_dir: SMPL files.
        out: folder for cells and tables.
        devices: ``cpu``, ``cuda``, or ``cuda:0`` and so on; with several, that many cells are made at once; the same
            one may be named twice.
    """

    table: str
    data: Path
    out: Path
    rows: tuple[str, ...] | None = None
    columns: tuple[str, ...] | None = None
    body_model_dir: Path | None = None
    devices: tuple[str, ...] = ("cpu",)


def reproduce(task: Reproduction, protocol: Protocol, progress: Progress, arguments: Sequence[str]) -> dict[str, Any]:
    """Makes every cell that is not there yet; the table is written anew after each.

    Args:
        arguments: the command's own, with which processes for single cells are started where there are several devices.

    Returns:
        ``cells`` made now, ``kept`` from before, ``of`` how many, and the ``table``'s file.

    Raises:
        TableError: an unknown table, row or column, or cells of another protocol.
        DatasetError, TrainingError, OSError: of a cell; those that are done stay.
    """
    table = find_table(task.table)
    cells = cells_of(task.table, task.rows, task.columns)
    folders = {cell.slug: task.out / task.table / CELLS / cell.slug for cell in cells}
    before = [cell for cell in cells if finished(folders[cell.slug], protocol) is not None]
    waiting = [cell for cell in cells if cell not in before]
    file = task.out / task.table / f"{task.table}.md"
    progress.start("reproduce", len(cells), done=len(before), unit="cell")
    told = {"of": len(cells), "kept": len(before), "table": str(file)}

    def tabulate() -> int:
        """Writes the table of everything that is there, also of rows and columns that were not asked for now."""
        made = []
        for cell in cells_of(task.table):
            folder = task.out / task.table / CELLS / cell.slug
            result = finished(folder, protocol)
            if result is not None:
                made.append((cell, folder, result))
        results = {(cell.row, cell.column_name): result for cell, _, result in made}
        write_report(task.out / task.table, task.table, table, results, protocol)
        for row in table.rows:
            of_row = [(cell, folder) for cell, folder, _ in made if cell.row == row]
            draw_row(task.out / task.table / f"{row}.png", row, of_row, table)
        draw_table(task.out / task.table / f"{task.table}.png", [(cell, folder) for cell, folder, _ in made], table)
        count = sum((cell.row, cell.column_name) in results for cell in cells)
        progress.update(count, f"{count} of {len(cells)} cells")
        return count

    if len(task.devices) > 1:
        _side_by_side(waiting, task, arguments, progress, tabulate)
    else:
        for cell in waiting:
            data = open_cell(task.data, cell, task.body_model_dir, protocol.frames)
            part = _Part(progress, len(before) + waiting.index(cell), cell.slug)
            make_cell(cell, data, folders[cell.slug], protocol, part, task.devices[0])
            if progress.cancelled_by_user:
                break
            tabulate()
    done = tabulate()
    told["cells"] = done - len(before)
    finish = progress.cancelled if progress.cancelled_by_user else progress.result
    finish(**told)
    return told


class _Part(Progress):
    """The progress of one cell's training and tests, told as a part of the whole."""

    def __init__(self, whole: Progress, done: int, label: str) -> None:
        super().__init__("terminal", whole.cancel)
        self._whole, self._done, self._label, self._length = whole, done, label, 1.0

    def start(self, job: str, total: float | None, done: float = 0.0, unit: str = "") -> None:  # noqa: ARG002
        self.job, self._length = job, total or 1.0

    def update(self, done: float, message: str = "", **fields: Any) -> None:  # noqa: ARG002
        share = min(done / self._length, 1.0)
        self._whole.update(self._done, f"{self._label}: {self.job} {100 * share:.0f} %", **fields)

    def result(self, **fields: Any) -> None:
        """The whole goes on."""

    def cancelled(self, **fields: Any) -> None:
        """The whole says so."""


def _side_by_side(
    waiting: Sequence[Cell], task: Reproduction, arguments: Sequence[str], progress: Progress, tabulate: Any
) -> None:
    """A process for every cell, one on each of the devices at a time; each makes its cell as a single run would."""
    queue = list(waiting)
    running: dict[int, tuple[Cell, subprocess.Popen[bytes]]] = {}
    failed: list[str] = []
    while queue or running:
        for place, device in enumerate(task.devices):
            if place not in running and queue and not progress.cancelled_by_user and not failed:
                cell = queue.pop(0)
                running[place] = cell, _start(cell, device, arguments, task)
        if progress.cancelled_by_user or failed:
            queue.clear()
            for _, process in running.values():
                process.terminate()
        for place, (cell, process) in list(running.items()):
            if process.poll() is None:
                continue
            del running[place]
            if process.returncode != 0 and not progress.cancelled_by_user:
                log = task.out / task.table / CELLS / f"{cell.slug}.log"
                failed.append(f"the cell {cell.slug} failed with exit code {process.returncode}; {log} says why")
            tabulate()
        time.sleep(POLL_SECONDS)
    if failed:
        raise TableError("; ".join(failed))


def _start(cell: Cell, device: str, arguments: Sequence[str], task: Reproduction) -> subprocess.Popen[bytes]:
    """``chona reproduce`` of one cell on one device."""
    kind, _, number = device.partition(":")
    environment = dict(os.environ)
    if number:
        environment["CUDA_VISIBLE_DEVICES"] = number
    command = [sys.executable, "-m", "chona_model", *arguments, "--rows", cell.row, "--columns", cell.column_name,
               "--devices", kind]  # fmt: skip
    log = task.out / task.table / CELLS / f"{cell.slug}.log"
    write_bytes(log, b"")
    with log.open("wb") as stream:
        return subprocess.Popen(command, env=environment, stdout=stream, stderr=stream)

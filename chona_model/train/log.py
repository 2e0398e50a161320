"""``log.jsonl``: how a training went, one JSON object a line, every step at most once."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Self

from chona_model.formats.atomic import WriteError, write_bytes

NAME = "log.jsonl"
MOST_LINES = 20_000
"""Some megabytes."""


class TrainingLog:
    """Writes lines; continues the log of a run that was stopped.

    Args:
        run: the run's folder; done: steps of the checkpoint that is continued, 0 for a new run, whose log is new too.
        most: lines at most: of a longer log every second one is dropped, again and again.
    """

    def __init__(self, run: Path, done: int, most: int = MOST_LINES) -> None:
        path = run / NAME
        lines = kept_lines(path, done) if done > 0 and path.exists() else []
        if lines:
            # What was killed had gone on after its checkpoint, and may have left half a line.
            write_bytes(path, "".join(line + "\n" for line in lines).encode())
        self._path, self._lines = path, len(lines)
        self._most, self._spacing, self._next = most, 0, 0
        self._file = path.open("a" if done > 0 else "w", encoding="utf-8", buffering=1)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.close()
        except OSError as problem:  # a full disk was told of already
            if kind is None:
                raise WriteError(self._path, problem) from problem

    def write(self, step: int, seconds: float, report: dict[str, float]) -> None:
        """One line: steps done, seconds of training, and the step's report.  It can be read at once.

        Raises:
            WriteError: the disk is full.
        """
        try:
            if step < self._next:
                return
            if self._lines >= self._most:
                self._thin(step)
            self._file.write(json.dumps({"step": step, "seconds": round(seconds, 3), **report}) + "\n")
            self._lines, self._next = self._lines + 1, step + self._spacing
        except WriteError:
            raise
        except OSError as error:
            raise WriteError(self._path, error) from error

    def _thin(self, step: int) -> None:
        """Drops every second line, and from now on writes as seldom: a curve keeps its shape."""
        lines = kept_lines(self._path, None)[::2]
        self._spacing = step // len(lines)
        self._file.close()
        write_bytes(self._path, "".join(line + "\n" for line in lines).encode())
        self._file = self._path.open("a", encoding="utf-8", buffering=1)
        self._lines = len(lines)


def kept_lines(path: Path, done: int | None) -> list[str]:
    """The log's whole lines of steps up to ``done``, or of all, each step once."""
    kept: dict[int, str] = {}
    for line in path.read_text("utf-8", errors="replace").splitlines():
        try:
            step = int(json.loads(line)["step"])
        except (ValueError, KeyError, TypeError):
            continue
        if done is None or step <= done:
            kept.setdefault(step, line)
    return [kept[step] for step in sorted(kept)]
